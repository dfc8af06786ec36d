"""Springs, weight and stops: laws of bodies that keep their place, planted by other code and named."""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from stated import check_named_alone, check_nothing_found, stated

from examples.car import CAR
from examples.drive import DRIVE
from examples.machines import BALL
from simgap.effects import CATALOGUE, restoring, stops
from simgap.effects.augmented import Augmented
from simgap.layout import Layout
from simgap.simulators.spot import Spot
from simgap.types import Field, Parameter, Recording, Schema

IDS = {"nonlinear_spring", "joint_gravity", "output_limit"}
ROWS, FINER, NOISE = 200, 50, 1e-3
SPRING = 3.0
Torque = Callable[[float], float]
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


def session(
    rng: np.random.Generator, torque: Torque = lambda q: 0.0 * q, stop: float = np.inf, rail: float = np.inf
) -> Recording:
    """The joint with a further torque(q), in steps far finer than a row; it may stop, or its sensor."""
    h, q, w, seen = JOINT.time_step, 0.0, 0.0, []
    phases, t = rng.uniform(0, 2 * np.pi, 4), JOINT.time_step * np.arange(ROWS)
    command = 2.0 * np.sin(np.array([1.3, 2.1, 3.7, 5.9]) * t[:, None] + phases).sum(1)
    for u in command:
        seen.append((q, w))
        for _ in range(FINER):
            w += h / FINER * (u - SPRING * q - 0.5 * w + torque(q))
            q += h / FINER * w
            if abs(q) > stop:
                q, w = np.sign(q) * stop, 0.0
    state = np.array(seen) + NOISE * rng.standard_normal((ROWS, 2))
    state[:, 0] = np.clip(state[:, 0], -rail, rail)
    return Recording(f"session_{rng.integers(10**6)}", t, state, command[:, None])


PLANTED = {
    "nonlinear_spring": ({"torque": lambda q: -2.0 * q - 5.0 * q**3}, {"stiffness": 2.0, "cubic": 5.0}),
    "joint_gravity": ({"torque": lambda q: -4.0 * np.sin(q - 0.4)}, {"moment": 4.0, "hanging": 0.4}),
    "output_limit.quantity": ({"stop": 0.8}, {"limit": 0.8}),
    "output_limit.sensor": ({"rail": 0.6}, {"limit": 0.6}),
}


@pytest.mark.parametrize("key", PLANTED)
def test_what_is_planted_is_named_with_its_constants(key: str) -> None:
    of, constants = PLANTED[key]
    check_named_alone(stated(JOINT, session, 0, **of), key, constants)


def test_where_nothing_is_planted_nothing_is_found() -> None:
    check_nothing_found(stated(JOINT, session, 1))


def test_bodies_that_wander_have_neither_springs_nor_stops() -> None:
    """A spring would tie them to the origin of the world, as it would a ball that falls."""
    for robot in (Spot(), CAR):
        augmented = Augmented(robot)
        assert not restoring.staying(augmented.layout)
        assert not stops.stopping(augmented.layout)
        assert not any(s for e, s in zip(CATALOGUE, augmented.sites, strict=True) if e.id in IDS)
    assert restoring.staying(Layout(BALL.schema)) == []
    assert len(restoring.staying(Layout(DRIVE.schema))) == 1
    assert stops.stopping(Layout(DRIVE.schema)) == [0, 1]
