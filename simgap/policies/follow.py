"""A policy on a robot, its hand to follow a reference [Hoffman et al. 2025, Shape Tracking]."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from simgap.recordings import HISTORY
from simgap.simulators.spot import SCHEMA, rotation, to_body
from simgap.types import Policy, Robot


@dataclass(frozen=True)
class Bounds:
    """Where the hand may be, in the base's frame; a run that is about to leave it is stopped.

    shoulder: its place, z above the floor [m]; reach: greatest distance of the hand from it [m]. clearance: least
    height above the floor [m]. body_low, body_high: corners of the box that the body takes [m]. look_ahead: how far
    ahead the hand's course is followed [s].
    """

    shoulder: tuple[float, float, float]
    reach: float
    clearance: float
    body_low: tuple[float, float, float]
    body_high: tuple[float, float, float]
    look_ahead: float


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
    """What the hand is on course for: "body", "ground" or "reach"; empty for nothing.

    Its course is a straight line in the base's frame, at its velocity relative to the base.
    """
    body = np.asarray(_to_body(state))
    base_velocity, hand, velocity = body[3:6], body[6:9], body[9:]
    carried = np.array([base_velocity[0], base_velocity[1], 0.0])
    carried += np.array([-base_velocity[2] * hand[1], base_velocity[2] * hand[0], 0.0])
    course = hand + (velocity - carried) * np.linspace(0.0, bounds.look_ahead, 5)[:, None]
    inside = (course > np.array(bounds.body_low)) & (course < np.array(bounds.body_high))
    if inside.all(axis=1).any():
        return "body"
    if (course[:, 2] < bounds.clearance).any():
        return "ground"
    if (np.linalg.norm(course - np.array(bounds.shoulder), axis=1) > bounds.reach).any():
        return "reach"
    return ""


def _about(state: Float[np.ndarray, " 12"], reference: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """The reference in the world, about the hand, x ahead of the robot."""
    return state[6:9] + reference @ np.asarray(rotation(state[2])).T


_to_body = jax.jit(to_body)


@jax.jit
def _command(
    policy: Policy, state: Float[Array, " 12"], past: Float[Array, "2 6"], goal: Float[Array, " 3"]
) -> Float[Array, " 6"]:
    return policy.command(state, past, goal)
