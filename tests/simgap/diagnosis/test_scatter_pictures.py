"""Pictures of effects on the scatter: dots lie about the line where the law is right, and not where it is wrong."""

from typing import Any

import numpy as np
import pytest

from simgap.diagnosis.inference.noise.effect import Axis, Between, Spectrum, Widening
from simgap.diagnosis.likelihood.student_t import Noise
from simgap.diagnosis.report.noise_figures import FEWEST, picture
from simgap.types import Field

NOISE = Noise(np.array([0.5, 1.0]), np.full(2, 1e6))
AXIS = Axis("time [s]", 0.1, 0.1, np.arange(-1.125, 4.2, 0.25))


def near_the_line(drawn: dict[str, Any]) -> float:
    """Share of the dots whose interval holds the line."""
    line = np.interp(drawn["x"], drawn["line_x"], drawn["line_y"])
    return float(np.mean(np.abs(line - drawn["y"]) <= drawn["y_err"]))


def stalled(shares: list[float], rows: int = 4000) -> list[dict[str, Any]]:
    """Of rows of which a tenth moved on for two intervals more; and what a law with these shares makes of it."""
    rng = np.random.default_rng(0)
    direction = rng.uniform(2, 4, (rows, 1)) * np.array([1.0, -1.0])
    late = 2 * (rng.random(rows) < 0.1)
    e = late[:, None] * direction + NOISE.scale * rng.normal(size=(rows, 2))
    return picture(Between([e, e - 2 * direction], direction, np.array(shares), NOISE, AXIS))


def test_rows_lie_where_the_right_mixture_has_them() -> None:
    (right,), (wrong,) = stalled([0.9, 0.1]), stalled([0.6, 0.4])
    assert right["y"].sum() == pytest.approx(right["line_y"].sum(), rel=0.02)
    assert right["x"][np.argmax(right["y"])] == pytest.approx(AXIS.plain)
    assert right["y"][right["x"] > 0.25].sum() == pytest.approx(400, rel=0.15)
    assert near_the_line(right) > 0.7
    assert near_the_line(wrong) < 0.3


def test_rows_that_do_not_move_make_no_picture() -> None:
    e = np.zeros((4 * FEWEST, 2))
    assert not picture(Between([e, e], 0.1 * np.ones_like(e), np.array([0.9, 0.1]), NOISE, AXIS))
    assert not stalled([0.9, 0.1], FEWEST - 1)


def test_scatter_widens_along_the_line() -> None:
    rng = np.random.default_rng(0)
    moving = np.tile(rng.uniform(0, 1.2, (4000, 1)), 2)
    e = (1 + 2 * moving) * NOISE.scale * rng.normal(size=(4000, 2))
    (right,), (wrong,) = (picture(Widening(e, NOISE, moving, ratio)) for ratio in (3.0, 1.5))
    assert near_the_line(right) > 0.8
    assert near_the_line(wrong) < 0.4


def test_a_wave_stands_over_the_level_around_it() -> None:
    power = np.full(33, 8.0)
    power[11:14] += np.array([10.0, 40.0, 10.0])
    (found,) = picture(Spectrum(power, 8.0, 12, 4, 0.25, Field("base_vy", "m/s", "velocity", "world")))
    np.testing.assert_allclose(found["line_y"], power[1:] / 4)
    np.testing.assert_allclose(found["y"], found["line_y"])
    assert found["x"][np.argmax(found["y"])] == 12 * 0.25
