"""A joint whose simulator knows its damping and a spring, and its recordings, in steps far finer than a row."""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.types import Field, Parameter, Recording, Schema

ROWS, FINER, NOISE = 200, 50, 1e-3
SPRING, DAMPING = 3.0, 0.5
SCHEMA = Schema(
    (Field("q", "rad", "position", "body", "joint", "yaw"), Field("w", "rad/s", "velocity", "body", "joint", "yaw")),
    (Field("cmd", "N m", "force", "body", "joint", "yaw"),),
)


@dataclass(frozen=True)
class Joint:
    """A joint that a torque turns against damping and a spring, with an inertia of 1 kg m^2."""

    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = (Parameter("damping", "N m s", 0.0, 2.0, nominal=0.6),)
    time_step: float = 0.02

    def step(
        self, params: Float[Array, " 1"], state: Float[Array, " 2"], command: Float[Array, " 1"]
    ) -> Float[Array, " 2"]:
        """The damping acts on the mean of old and new speed, the spring halfway."""
        k = self.time_step * params[0] / 2
        torque = command[0] - SPRING * (state[0] + self.time_step * state[1] / 2)
        after = ((1 - k) * state[1] + self.time_step * torque) / (1 + k)
        return jnp.stack([state[0] + self.time_step * (state[1] + after) / 2, after])


JOINT = Joint()
Follows = Callable[[float, float, float, float], tuple[float, float]]
"""(angle, speed, torque, time [s]) -> angle and speed after that time."""


def freely(q: float, w: float, torque: float, h: float) -> tuple[float, float]:
    """By the physics that the simulator knows."""
    w += h * (torque - SPRING * q - DAMPING * w)
    return q + h * w, w


def recorded(rng: np.random.Generator, follows: Follows = freely) -> Recording:
    """A session of the joint from rest, under four waves."""
    h, q, w, seen = JOINT.time_step, 0.0, 0.0, []
    phases, t = rng.uniform(0, 2 * np.pi, 4), JOINT.time_step * np.arange(ROWS)
    command = 2.0 * np.sin(np.array([1.3, 2.1, 3.7, 5.9]) * t[:, None] + phases).sum(1)
    for torque in command:
        seen.append((q, w))
        for _ in range(FINER):
            q, w = follows(q, w, torque, h / FINER)
    state = np.array(seen) + NOISE * rng.standard_normal((ROWS, 2))
    return Recording(f"session_{rng.integers(10**6)}", t, state, command[:, None])
