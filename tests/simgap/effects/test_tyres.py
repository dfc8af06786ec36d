"""Tyre slip: planted in a car by other code, and named."""

import numpy as np
import pytest
from stated import check_named_alone, check_nothing_found, stated

from examples.car import CAR
from simgap.effects import tyres
from simgap.effects.augmented import Augmented
from simgap.layout import Layout
from simgap.simulators.spot import Spot
from simgap.types import Recording

ROWS, FINER, NOISE = 200, 50, 2e-3
WHEELBASE, TAU = 0.32, 0.3


def session(rng: np.random.Generator, slip: float = 0.0, understeer: float = 0.0) -> Recording:
    """A car in bends, in steps far finer than a row, that slides outwards and turns less than its wheels roll."""
    h, (x, y, yaw, v), seen = CAR.time_step, np.zeros(4), []
    phases, t = rng.uniform(0, 2 * np.pi, 5), CAR.time_step * np.arange(ROWS)
    speed = 1.2 + 0.4 * np.sin(np.array([0.7, 1.9]) * t[:, None] + phases[:2]).sum(1)
    steering = 0.12 * np.sin(np.array([0.5, 1.1, 2.3]) * t[:, None] + phases[2:]).sum(1)
    for desired, angle in zip(speed, steering, strict=True):
        seen.append((x, y, yaw, v))
        for _ in range(FINER):
            w = v * np.tan(angle) / WHEELBASE / (1 + understeer * v**2)
            outwards = slip * v * w
            x += h / FINER * (v * np.cos(yaw) + outwards * np.sin(yaw))
            y += h / FINER * (v * np.sin(yaw) - outwards * np.cos(yaw))
            yaw += h / FINER * w
            v += h / FINER * (desired - v) / TAU
    state = np.array(seen) + NOISE * rng.standard_normal((ROWS, 4))
    return Recording(f"session_{rng.integers(10**6)}", t, state, np.stack([speed, steering], 1))


PLANTED = {"tyre_slip.sideways": {"slip": 0.15}, "tyre_slip.turning": {"understeer": 0.2}}


@pytest.mark.long
@pytest.mark.parametrize("key", PLANTED)
def test_what_is_planted_is_named_with_its_constants(key: str) -> None:
    check_named_alone(stated(CAR, session, 0, **PLANTED[key]), key, PLANTED[key])


@pytest.mark.long
def test_where_nothing_is_planted_nothing_is_found() -> None:
    check_nothing_found(stated(CAR, session, 1))


def test_what_walks_sideways_has_no_tyres() -> None:
    assert tyres.wheeled(Layout(CAR.schema)) == [0]
    augmented = Augmented(Spot())
    assert not tyres.wheeled(augmented.layout)
    assert not any(s for e, s in zip(augmented.catalogue, augmented.sites, strict=True) if e.id == "tyre_slip")
