"""A policy on a robot, its hand to follow a reference [Hoffman et al. 2025, Shape Tracking]."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from simgap.policies.bounds import BEYOND, Bounds, on_course_for
from simgap.recordings import HISTORY
from simgap.simulators.spot import SCHEMA, rotation
from simgap.types import Policy, Robot


class Run(NamedTuple):
    """What was done on a robot, row for row: states as measured, commands as admitted, goals of the hand.

    `stopped` says what the hand was on course for when the run was stopped early, and is empty where it was not.
    """

    states: Float[np.ndarray, "T 12"]
    commands: Float[np.ndarray, "T 6"]
    goals: Float[np.ndarray, "T 3"]
    stopped: str


def follow(robot: Robot, policy: Policy, reference: Float[np.ndarray, "T 3"], bounds: Bounds) -> Run:
    """Run a policy along a reference about the place where the hand is at the start; stopped early before a collision.

    The robot is stopped at the end whatever happens.
    """
    robot.reset()
    past = np.zeros((HISTORY, len(SCHEMA.command)), np.float32)
    states, commands, stopped = [], [], ""
    try:
        goals = _about(robot.observe(), reference)
        for goal in goals:
            state = robot.observe()
            stopped = collision(state, bounds)
            if stopped:
                break
            states.append(state)
            commands.append(robot.command(np.asarray(_command(policy, state, past, goal))))
            past = np.stack([*past[1:], commands[-1]]).astype(np.float32)
    finally:
        robot.stop()
    rows = len(states)
    return Run(np.reshape(states, (rows, 12)), np.reshape(commands, (rows, 6)), goals[:rows], stopped)


def mean_error(run: Run) -> float:
    """1/T sum_t |p_t^ee - g_t^ee| [m] [Hoffman et al. 2025, Shape Tracking], over the T rows that were run.

    NaN where there are none.
    """
    distance = np.linalg.norm(run.states[:, 6:9] - run.goals, axis=1)
    return float(distance.mean()) if len(distance) else float("nan")


def collision(state: Float[np.ndarray, " 12"], bounds: Bounds) -> str:
    """What the hand is on course for, one of `BEYOND`; empty for nothing."""
    met = np.asarray(_on_course_for(state, bounds))
    return BEYOND[int(met.argmax())] if met.any() else ""


def _about(state: Float[np.ndarray, " 12"], reference: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """The reference in the world, about the hand, x ahead of the robot."""
    return state[6:9] + reference @ np.asarray(rotation(state[2])).T


_on_course_for = jax.jit(on_course_for, static_argnames="bounds")


@jax.jit
def _command(
    policy: Policy, state: Float[Array, " 12"], past: Float[Array, "2 6"], goal: Float[Array, " 3"]
) -> Float[Array, " 6"]:
    return policy.command(state, past, goal)
