"""Draws are whole units; means of weights are means of the pieces drawn; the interval holds the mean."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simgap.diagnosis.validation.bootstrap import averages, averages_known, interval, resample


@given(st.lists(st.integers(0, 4), min_size=1, max_size=20), st.integers(0, 2**32 - 1))
def test_units_are_drawn_whole_and_as_many_as_there_are(unit: list[int], seed: int) -> None:
    draws, units = resample(np.array(unit), np.random.default_rng(seed)), np.array(unit)
    assert (draws[0] == 1).all()
    for u in np.unique(units):
        assert (draws[:, units == u] == draws[:, units == u][:, :1]).all()
    first = [int(np.flatnonzero(units == u)[0]) for u in np.unique(units)]
    assert (draws[:, first].sum(1) == len(first)).all()


@given(st.integers(0, 2**32 - 1))
def test_means_are_those_of_the_pieces_drawn(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, draws = rng.normal(size=(12, 2)), resample(rng.integers(0, 5, 12), rng)
    for weights, mean in zip(draws[:20], averages(values, draws), strict=False):
        np.testing.assert_allclose(mean, np.repeat(values, weights.astype(int), axis=0).mean(0))


def test_what_is_not_finite_counts_where_it_is_drawn_and_what_is_unknown_nowhere() -> None:
    draws = np.array([[1.0, 1.0, 1.0], [2.0, 1.0, 0.0], [0.0, 0.0, 3.0]])
    assert averages(np.array([[1.0], [4.0], [np.inf]]), draws)[:, 0].tolist() == [np.inf, 2.0, np.inf]
    np.testing.assert_array_equal(averages_known(np.array([1.0, 4.0, np.nan]), draws), [2.5, 2.0, np.nan])


def test_the_interval_of_a_mean_is_that_of_the_normal_distribution() -> None:
    """1.96 standard errors to either side, within a bootstrap's own error."""
    rng = np.random.default_rng(0)
    values = rng.normal(3.0, 2.0, (400, 1))
    found = interval(averages(values, resample(np.arange(400), rng))[:, 0])
    assert found["value"] == pytest.approx(values.mean())
    half = 1.96 * values.std() / 20
    assert np.subtract(found["ci95"], values.mean()) == pytest.approx([-half, half], rel=0.1)
