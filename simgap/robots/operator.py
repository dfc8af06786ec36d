"""A scripted operator who teleoperates the virtual Spot, for recordings that need neither robot nor person.

Like a person at two sticks, the operator works in phases (base, arm, both, rest), pushes the sticks to new places every
second or so, and watches the robot: the base stays in its room and the hand where the arm works well.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from simgap.robots import virtual_spot
from simgap.robots.virtual_spot import VirtualSpotConfig, VirtualSpotState
from simgap.simulators.spot import rotation
from simgap.types import Recording

_PHASES = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.0, 0.0))
"""Which of base and arm move: base only, arm only, both, rest."""


@dataclass(frozen=True)
class OperatorConfig:
    """How the operator works.

    `phase_probability` of base only, arm only, both, rest [-]; `phase_time`, shortest and longest phase [s];
    `hold_time`, shortest and longest time for which the sticks have one goal [s]; `push_probability` that a goal moves
    an axis at all, by axis [-]; `push`, greatest push in units of a stick's travel [-]; `stick_time`, time constant in
    which a stick follows its goal [s].
    `most`, command at the end of a stick's travel [m/s, m/s, rad/s, m/s, m/s, m/s].
    `room`: greatest |x| and |y| of the base in the world [m]; `hand_low`, `hand_high`: corners of the hand's box in the
    base's frame [m]; `caution`, greatest speed towards their bounds per distance left [1/s].
    """

    phase_probability: tuple[float, float, float, float] = (0.3, 0.2, 0.4, 0.1)
    phase_time: tuple[float, float] = (2.0, 8.0)
    hold_time: tuple[float, float] = (0.5, 2.5)
    push_probability: tuple[float, ...] = (0.8, 0.4, 0.4, 0.6, 0.6, 0.6)
    push: float = 1.5
    stick_time: float = 0.1
    most: tuple[float, ...] = (1.0, 0.8, 1.0, 0.8, 0.8, 0.8)
    room: float = 2.2
    hand_low: tuple[float, float, float] = (0.55, -0.40, 0.20)
    hand_high: tuple[float, float, float] = (1.10, 0.40, 0.95)
    caution: float = 2.5


class OperatorState(NamedTuple):
    """What the operator is about: `moving` of base and arm (0 or 1), the sticks' goals and places, times left [s]."""

    moving: Float[Array, " 2"]
    phase_left: Float[Array, ""]
    goal: Float[Array, " 6"]
    goal_left: Float[Array, ""]
    stick: Float[Array, " 6"]


def init() -> OperatorState:
    """Hands off the sticks, about to choose."""
    return OperatorState(jnp.zeros(2), jnp.zeros(()), jnp.zeros(6), jnp.zeros(()), jnp.zeros(6))


def step(
    state: OperatorState, measured: Float[Array, " 12"], key: PRNGKeyArray, time_step: float, config: OperatorConfig
) -> tuple[OperatorState, Float[Array, " 6"]]:
    """The command [m/s, rad/s, body frame] on seeing the robot as `measured`, `time_step` [s] after the last one."""
    key_phase, key_goal = jax.random.split(key)
    moving, phase_left = _choose_phase(state, key_phase, config)
    goal, goal_left = _choose_goal(state, key_goal, config)
    wanted = jnp.repeat(moving, 3) * _careful(goal, measured, config)
    # A hand needs time to move a stick: commands have no jumps.
    stick = wanted + jnp.exp(-time_step / config.stick_time) * (state.stick - wanted)
    return OperatorState(moving, phase_left - time_step, goal, goal_left - time_step, stick), stick


def record(
    key: PRNGKeyArray, seconds: float, robot_config: VirtualSpotConfig, operator_config: OperatorConfig, name: str
) -> Recording:
    """A session of `seconds` [s], at first at rest anywhere in the room, the hand anywhere in its box's middle half."""
    rows = round(seconds / robot_config.time_step)
    state, command = _run(key, rows, robot_config, operator_config)
    time_s = np.arange(rows) * robot_config.time_step
    return Recording(name, time_s, np.asarray(state, np.float64), np.asarray(command, np.float64))


@partial(jax.jit, static_argnames=("rows", "robot_config", "operator_config"))
def _run(
    key: PRNGKeyArray, rows: int, robot_config: VirtualSpotConfig, operator_config: OperatorConfig
) -> tuple[Float[Array, "rows 12"], Float[Array, "rows 6"]]:
    key_start, key_rows = jax.random.split(key)

    def row(
        carry: tuple[VirtualSpotState, OperatorState], key: PRNGKeyArray
    ) -> tuple[tuple[VirtualSpotState, OperatorState], tuple[Float[Array, " 12"], Float[Array, " 6"]]]:
        robot, operator = carry
        key_measure, key_operate, key_step = jax.random.split(key, 3)
        measured = virtual_spot.measure(robot, key_measure, robot_config)
        operator, command = step(operator, measured, key_operate, robot_config.time_step, operator_config)
        robot = virtual_spot.step(robot, command, key_step, robot_config)
        return (robot, operator), (measured, command)

    start = (_start(key_start, robot_config, operator_config), init())
    return jax.lax.scan(row, start, jax.random.split(key_rows, rows))[1]


def _start(key: PRNGKeyArray, robot_config: VirtualSpotConfig, operator_config: OperatorConfig) -> VirtualSpotState:
    key_pose, key_hand = jax.random.split(key)
    low, high = jnp.array(operator_config.hand_low), jnp.array(operator_config.hand_high)
    extent = jnp.array([operator_config.room, operator_config.room, jnp.pi])
    return virtual_spot.init(robot_config)._replace(
        base_pose=extent * jax.random.uniform(key_pose, (3,), minval=-1.0),
        # The box's corners are out of reach, its middle half is not.
        hand=(low + high) / 2 + (high - low) / 4 * jax.random.uniform(key_hand, (3,), minval=-1.0),
    )


def _choose_phase(
    state: OperatorState, key: PRNGKeyArray, config: OperatorConfig
) -> tuple[Float[Array, " 2"], Float[Array, ""]]:
    """The phase at hand, or the next once its time is up."""
    key_which, key_time = jax.random.split(key)
    which = jax.random.choice(key_which, len(_PHASES), p=jnp.array(config.phase_probability))
    time = jax.random.uniform(key_time, minval=config.phase_time[0], maxval=config.phase_time[1])
    over = state.phase_left <= 0
    return jnp.where(over, jnp.array(_PHASES)[which], state.moving), jnp.where(over, time, state.phase_left)


def _choose_goal(
    state: OperatorState, key: PRNGKeyArray, config: OperatorConfig
) -> tuple[Float[Array, " 6"], Float[Array, ""]]:
    """Where the sticks are pushed, or the next place once its time is up."""
    key_push, key_where, key_time = jax.random.split(key, 3)
    pushed = jax.random.bernoulli(key_push, jnp.array(config.push_probability))
    # Beyond the end of its travel a stick stays there, where people often hold it.
    travel = jnp.clip(config.push * jax.random.uniform(key_where, (6,), minval=-1.0), -1.0, 1.0)
    goal = pushed * travel * jnp.array(config.most)
    time = jax.random.uniform(key_time, minval=config.hold_time[0], maxval=config.hold_time[1])
    over = state.goal_left <= 0
    return jnp.where(over, goal, state.goal), jnp.where(over, time, state.goal_left)


def _careful(goal: Float[Array, " 6"], measured: Float[Array, " 12"], config: OperatorConfig) -> Float[Array, " 6"]:
    """The goal [m/s, rad/s, body frame] as far as the bounds allow: slower towards them, back beyond them."""
    R = rotation(measured[2])
    base = jnp.array([measured[0], measured[1], 0.0])
    hand = R.T @ (measured[6:9] - base)
    # The room lies in the world's frame, and turning never leaves it.
    room = jnp.array([config.room, config.room, jnp.inf])
    u_base = R.T @ jnp.clip(R @ goal[:3], -config.caution * (room + base), config.caution * (room - base))
    bounds = (config.caution * (jnp.array(corner) - hand) for corner in (config.hand_low, config.hand_high))
    u_ee = jnp.clip(goal[3:], *bounds)
    most = jnp.array(config.most)
    return jnp.clip(jnp.concatenate([u_base, u_ee]), -most, most)
