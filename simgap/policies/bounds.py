"""Where a hand may be: on course beyond it, a run on the robot is stopped, and an episode of learning may end."""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from simgap.simulators.spot import to_body

BEYOND = ("body", "ground", "reach")
"""What a hand may be on course for, in the order of `on_course_for`."""


@dataclass(frozen=True)
class Bounds:
    """Where the hand may be, in the base's frame.

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


def on_course_for(state: Float[Array, " 12"], bounds: Bounds) -> Bool[Array, " 3"]:
    """Whether the hand is on course for each of `BEYOND`; the state in the columns of `spot.SCHEMA`.

    Its course is a straight line in the base's frame, at its velocity relative to the base.
    """
    body = to_body(state)
    base_velocity, hand, velocity = body[3:6], body[6:9], body[9:]
    turning = base_velocity[2] * jnp.array([-hand[1], hand[0]])
    relative = velocity.at[:2].add(-base_velocity[:2] - turning)
    course = hand + relative * jnp.linspace(0.0, bounds.look_ahead, 5)[:, None]
    inside = (course > jnp.array(bounds.body_low)) & (course < jnp.array(bounds.body_high))
    away = jnp.linalg.norm(course - jnp.array(bounds.shoulder), axis=1)
    return jnp.array([inside.all(axis=1).any(), (course[:, 2] < bounds.clearance).any(), (away > bounds.reach).any()])
