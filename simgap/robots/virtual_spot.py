"""A virtual Spot with arm: the robot that recordings come from where there is no real one.

It stands in for reality, not for a simulator to learn with, and has physics that the kinematic model lacks: delays,
lags in the body frame, reactions between arm and base, limits of the arm, stepping. The base is a body (x, y, yaw) with
velocity v in its own frame, the hand (end-effector) a point r in the base's frame with velocity w relative to it:
nothing depends on where the world frame lies.

    x' = R(yaw) v                                    r' = w
    v' = a_base - base reaction to a_arm             a_base = (u_base(t - d_base) - v) / tau_base + stepping
    w' = a_arm - base_arm_coupling (a_base at r)     a_arm = (limited u_ee(t - d_ee) - w) / tau_arm + stepping

`init`, `step` and `measure` take commands and give measurements in the columns of `spot.SCHEMA`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from simgap.simulators.spot import induced_velocity, rotation

_BASE_HARMONIC = (2, 1, 1)
_HAND_HARMONIC = (2, 1, 2)
"""Oscillations per stride: both feet of a stride push and lift alike, but sway and yaw to opposite sides."""


@dataclass(frozen=True)
class VirtualSpotConfig:
    """The robot's physical constants.

    Time: `time_step` between rows [s], integrated in `sub_steps` equal steps.
    Commands: `base_delay`, `arm_delay` between sending and acting [s]; `base_lag` of v_x, v_y, w_z and `arm_lag` of the
    hand's relative velocity, time constants [s].
    Couplings: `arm_base_coupling`, base acceleration per hand acceleration [-]; `arm_yaw_coupling`, yaw acceleration
    per moment of the hand's acceleration about the base [rad/m^2]; `base_arm_coupling`, share of the base's
    acceleration by which the hand stays behind [-].
    Arm: `shoulder` x, y, z in the base's frame, z above the floor [m]; `home`, the hand's position at the start [m];
    `reach` and `inner_reach`, greatest and least distance of the hand from the shoulder [m]; `hand_clearance`, least
    height of the hand above the floor [m]; `limit_time`, in which the arm may close the distance to a limit [s].
    Stepping: `stride_frequency` [Hz]; `half_speed`, walking speed at which half of the stepping's amplitude is reached
    [m/s]; `turning_radius` that makes a yaw rate a walking speed [m]; `base_ripple` [m/s, m/s, rad/s] and `hand_ripple`
    [m/s], the amplitudes.
    Noise: `base_process_noise` [m/s/sqrt(s), m/s/sqrt(s), rad/s/sqrt(s)] and `hand_process_noise` [m/s/sqrt(s)] on the
    velocities; `base_measurement_noise`, `hand_measurement_noise`, standard deviations of pose and velocity in the
    order and units of `spot.SCHEMA`.
    """

    time_step: float = 1 / 15
    sub_steps: int = 10
    base_delay: float = 0.13
    arm_delay: float = 0.11
    base_lag: tuple[float, float, float] = (0.16, 0.14, 0.12)
    arm_lag: float = 0.08
    arm_base_coupling: float = 0.10
    arm_yaw_coupling: float = 0.35
    base_arm_coupling: float = 0.25
    shoulder: tuple[float, float, float] = (0.29, 0.0, 0.65)
    home: tuple[float, float, float] = (0.85, 0.0, 0.60)
    reach: float = 1.0
    inner_reach: float = 0.35
    hand_clearance: float = 0.06
    limit_time: float = 0.35
    stride_frequency: float = 2.0
    half_speed: float = 0.3
    turning_radius: float = 0.4
    base_ripple: tuple[float, float, float] = (0.10, 0.08, 0.40)
    hand_ripple: tuple[float, float, float] = (0.06, 0.12, 0.15)
    base_process_noise: tuple[float, float, float] = (0.04, 0.04, 0.06)
    hand_process_noise: tuple[float, float, float] = (0.06, 0.06, 0.06)
    base_measurement_noise: tuple[float, ...] = (0.001, 0.001, 0.002, 0.01, 0.01, 0.015)
    hand_measurement_noise: tuple[float, ...] = (0.002, 0.002, 0.002, 0.02, 0.02, 0.02)


class VirtualSpotState(NamedTuple):
    """What the robot is and remembers; `commands[k]` was sent k sub-steps before the latest.

    base_pose: x, y, yaw in the world [m, m, rad]; the yaw is not wrapped.
    base_velocity: v_x, v_y, w_z in the base's frame [m/s, m/s, rad/s].
    hand: position in the base's frame, z above the floor [m].
    hand_velocity: its time derivative [m/s].
    stride: phase of the gait [rad].
    """

    base_pose: Float[Array, " 3"]
    base_velocity: Float[Array, " 3"]
    hand: Float[Array, " 3"]
    hand_velocity: Float[Array, " 3"]
    stride: Float[Array, ""]
    commands: Float[Array, "K 6"]


def init(config: VirtualSpotConfig) -> VirtualSpotState:
    """The robot standing still at the world's origin, the hand at home, no command on its way."""
    remembered = int(max(config.base_delay, config.arm_delay) / _sub_step(config)) + 2
    zeros = jnp.zeros(3)
    return VirtualSpotState(zeros, zeros, jnp.array(config.home), zeros, jnp.zeros(()), jnp.zeros((remembered, 6)))


def step(
    state: VirtualSpotState, command: Float[Array, " 6"], key: PRNGKeyArray, config: VirtualSpotConfig
) -> VirtualSpotState:
    """The state `time_step` later, `command` [m/s, rad/s] being sent throughout; `key` draws the process noise."""
    scale = jnp.array(config.base_process_noise + config.hand_process_noise) * jnp.sqrt(_sub_step(config))
    noise = scale * jax.random.normal(key, (config.sub_steps, 6))
    return jax.lax.scan(lambda s, n: (_advance(s, command, n, config), None), state, noise)[0]


def measure(state: VirtualSpotState, key: PRNGKeyArray, config: VirtualSpotConfig) -> Float[Array, " 12"]:
    """The state as measured, in the columns of `spot.SCHEMA`: world frame, with noise, yaw in [-pi, pi]."""
    R = rotation(state.base_pose[2])
    base_motion = state.base_velocity.at[2].set(0.0)
    p_ee = state.base_pose.at[2].set(0.0) + R @ state.hand
    v_ee = R @ (base_motion + induced_velocity(state.base_velocity[2], state.hand) + state.hand_velocity)
    true = jnp.concatenate([state.base_pose, R @ state.base_velocity, p_ee, v_ee])
    scale = jnp.array(config.base_measurement_noise + config.hand_measurement_noise)
    measured = true + scale * jax.random.normal(key, (12,))
    return measured.at[2].set(jnp.arctan2(jnp.sin(measured[2]), jnp.cos(measured[2])))


def _sub_step(config: VirtualSpotConfig) -> float:
    return config.time_step / config.sub_steps


def _advance(
    state: VirtualSpotState, command: Float[Array, " 6"], noise: Float[Array, " 6"], config: VirtualSpotConfig
) -> VirtualSpotState:
    """One sub-step: velocities first, positions by the new velocities."""
    h = _sub_step(config)
    commands = jnp.concatenate([command[None], state.commands[:-1]])
    u_base = _delayed(commands, config.base_delay / h)[:3]
    u_ee = _within_limits(_delayed(commands, config.arm_delay / h)[3:], state.hand, config)

    activity = _walking(state.base_velocity, config)
    a_base = (u_base - state.base_velocity) / jnp.array(config.base_lag)
    a_base += activity * _stepping(state.stride, config.base_ripple, _BASE_HARMONIC, config)
    a_arm = (u_ee - state.hand_velocity) / config.arm_lag
    a_arm += activity * _stepping(state.stride, config.hand_ripple, _HAND_HARMONIC, config)

    v = state.base_velocity + h * (a_base - _base_reaction(a_arm, state.hand, config)) + noise[:3]
    w = state.hand_velocity + h * (a_arm - _hand_reaction(a_base, state.hand, config)) + noise[3:]
    # The mean heading of the sub-step keeps a turning robot on its circle.
    heading = state.base_pose[2] + h * v[2] / 2
    return VirtualSpotState(
        base_pose=state.base_pose + h * rotation(heading) @ v,
        base_velocity=v,
        hand=state.hand + h * w,
        hand_velocity=w,
        stride=state.stride + h * activity * 2 * jnp.pi * config.stride_frequency,
        commands=commands,
    )


def _delayed(commands: Float[Array, "K 6"], delay: float) -> Float[Array, " 6"]:
    """The command sent `delay` sub-steps ago, between two of them in proportion."""
    whole = int(delay)
    return commands[whole] + (delay - whole) * (commands[whole + 1] - commands[whole])


def _within_limits(u_ee: Float[Array, " 3"], hand: Float[Array, " 3"], config: VirtualSpotConfig) -> Float[Array, " 3"]:
    """The arm's command [m/s] as far as its limits let it be followed.

    Towards a limit no faster than (distance left) / limit_time, so that commands fade out before it; beyond it, where a
    reaction may throw the hand, back at that rate.
    """
    arm = hand - jnp.array(config.shoulder)
    distance = jnp.linalg.norm(arm)
    outward = u_ee @ arm / distance
    slowest, fastest = (limit - distance for limit in (config.inner_reach, config.reach))
    followed = jnp.clip(outward, slowest / config.limit_time, fastest / config.limit_time)
    u_ee = u_ee + (followed - outward) * arm / distance
    return u_ee.at[2].max((config.hand_clearance - hand[2]) / config.limit_time)


def _walking(v: Float[Array, " 3"], config: VirtualSpotConfig) -> Float[Array, ""]:
    """Share of the stepping's full amplitude, s^2 / (s^2 + half_speed^2) at walking speed s: nil and flat at rest."""
    speed_squared = v[0] ** 2 + v[1] ** 2 + (config.turning_radius * v[2]) ** 2
    return speed_squared / (speed_squared + config.half_speed**2)


def _stepping(
    stride: Float[Array, ""],
    amplitude: tuple[float, float, float],
    harmonic: tuple[int, int, int],
    config: VirtualSpotConfig,
) -> Float[Array, " 3"]:
    """Acceleration of a velocity that oscillates by `amplitude` at `harmonic` times the stride's frequency."""
    order = jnp.array(harmonic)
    return 2 * jnp.pi * config.stride_frequency * order * jnp.array(amplitude) * jnp.cos(order * stride)


def _base_reaction(
    a_arm: Float[Array, " 3"], hand: Float[Array, " 3"], config: VirtualSpotConfig
) -> Float[Array, " 3"]:
    """What the base loses to an arm that accelerates: a share of it, and its moment about the base as yaw."""
    moment = hand[0] * a_arm[1] - hand[1] * a_arm[0]
    push = config.arm_base_coupling * a_arm
    return push.at[2].set(config.arm_yaw_coupling * moment)


def _hand_reaction(
    a_base: Float[Array, " 3"], hand: Float[Array, " 3"], config: VirtualSpotConfig
) -> Float[Array, " 3"]:
    """What the hand loses to a base that accelerates: the arm yields to a share of its inertia."""
    return config.base_arm_coupling * (a_base.at[2].set(0.0) + induced_velocity(a_base[2], hand))
