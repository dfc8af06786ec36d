"""Springs, weight and stops: laws of bodies that keep their place, planted by other code and named."""

from collections.abc import Callable

import numpy as np
import pytest
from joint import JOINT, freely, recorded
from stated import check_named_alone, check_nothing_found, stated

from examples.car import CAR
from examples.drive import DRIVE
from examples.machines import BALL
from simgap.effects import CATALOGUE, restoring, stops
from simgap.effects.augmented import Augmented
from simgap.layout import Layout
from simgap.simulators.spot import Spot
from simgap.types import Recording

IDS = {"nonlinear_spring", "joint_gravity", "output_limit"}
Torque = Callable[[float], float]


def session(
    rng: np.random.Generator, torque: Torque = lambda q: 0.0 * q, stop: float = np.inf, rail: float = np.inf
) -> Recording:
    """The joint with a further torque(q); it may stop, or its sensor."""

    def follows(q: float, w: float, driven: float, h: float) -> tuple[float, float]:
        q, w = freely(q, w, driven + torque(q), h)
        return (np.sign(q) * stop, 0.0) if abs(q) > stop else (q, w)

    recording = recorded(rng, follows)
    recording.state[:, 0] = np.clip(recording.state[:, 0], -rail, rail)
    return recording


PLANTED = {
    "nonlinear_spring": ({"torque": lambda q: -2.0 * q - 5.0 * q**3}, {"stiffness": 2.0, "cubic": 5.0}),
    "joint_gravity": ({"torque": lambda q: -4.0 * np.sin(q - 0.4)}, {"moment": 4.0, "hanging": 0.4}),
    "output_limit.quantity": ({"stop": 0.8}, {"limit": 0.8}),
    "output_limit.sensor": ({"rail": 0.6}, {"limit": 0.6}),
}


@pytest.mark.long
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
