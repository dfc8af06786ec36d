"""How a place was reached: what a segment knows of the way before it, for laws of hysteresis."""

from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simgap.diagnosis.likelihood.ways import TURNED, Ways, _turns, reached, ways_of

NOISE = 0.1


def bent(rows: np.ndarray) -> float:
    """Dahl's bristles of length one after a way, from rest."""
    after = lambda z, way: np.sign(way) + (z - np.sign(way)) * np.exp(-abs(way)) if way else z  # noqa: E731
    return float(reduce(after, np.diff(rows), 0.0))


def exactly(x: np.ndarray) -> Ways:
    """The ways of states without noise."""
    return Ways(x, tuple(map(_turns, x.T)))


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=TURNED))
@settings(max_examples=100, deadline=None)
def test_where_it_turned_tells_how_far_bristles_are_bent(places: list[int]) -> None:
    x = np.array(places, float)[:, None]
    points = reached(exactly(x), len(x))
    assert points.shape == (TURNED, 1)
    assert points[0] == x[-1]
    assert bent(points[::-1, 0]) == pytest.approx(bent(x[:, 0]))


def test_of_many_turns_the_latest_are_kept() -> None:
    x = np.arange(200.0)[:, None] * np.where(np.arange(200) % 2, 1, -1)[:, None]
    np.testing.assert_array_equal(reached(exactly(x), 200), x[::-1][:TURNED])


def test_before_its_first_row_a_session_stood_still() -> None:
    x = np.arange(5.0)[:, None]
    np.testing.assert_array_equal(reached(exactly(x), 0), np.zeros((TURNED, 1)))


@given(st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_noise_goes_no_way(seed: int) -> None:
    noise = NOISE * np.random.default_rng(seed).standard_normal((500, 1))
    gone = lambda x: float(np.abs(np.diff(ways_of(x).moved, axis=0)).sum())  # noqa: E731
    assert gone(noise) < 20 * NOISE < np.abs(np.diff(noise, axis=0)).sum() / 20
    there_and_back = 50 * np.abs(np.linspace(-1, 1, 500))[:, None]
    assert gone(there_and_back + noise) == pytest.approx(100, abs=20 * NOISE)
