"""What can be foretold of innovations: nothing of noise, of a drift what theory says; and what it does to names."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import SPOT
from small import problem, sessions

from simgap.diagnosis.inference.misfit.whiteness import named_share, whiteness
from simgap.diagnosis.inference.two_sample import whiteness_since
from simgap.diagnosis.likelihood.problem import Fit, Problem, start
from simgap.diagnosis.likelihood.segments import rows_of
from simgap.diagnosis.likelihood.student_t import Noise, fit_noise, log_density

quick = settings(max_examples=10, deadline=None)


@pytest.fixture(scope="module")
def of() -> Problem:
    return problem(sessions({})[0])


def fit(of: Problem, e: np.ndarray) -> Fit:
    """A fit that leaves these innovations."""
    noise = fit_noise(e)
    return Fit(start(of), (), e.astype(np.float32), noise, float(log_density(e, noise).sum()))


def size(of: Problem) -> tuple[int, int]:
    return int(np.asarray(of.chunks.counts).sum()), len(of.whiten)


@given(seed=st.integers(0, 2**31 - 1), dof=st.sampled_from([2.5, 5.0, 60.0]))
@quick
def test_nothing_is_foretold_of_noise(of: Problem, seed: int, dof: float) -> None:
    left = whiteness(of, fit(of, np.random.default_rng(seed).standard_t(dof, size(of))))
    assert not left.nats.any()
    assert not left.share.any()
    assert not left.predicted.any()


@pytest.mark.parametrize("memory", [0.5, 0.9])
def test_of_a_drift_theory_says_how_much(of: Problem, memory: float) -> None:
    """x' = a x + w is foretold to the share a^2."""
    n, outputs = size(of)
    rng = np.random.default_rng(1)
    e = rng.normal(size=(n, outputs))
    for t in range(1, n):
        e[t, 4] = memory * e[t - 1, 4] + np.sqrt(1 - memory**2) * rng.normal()
    left = whiteness(of, fit(of, e))
    assert np.flatnonzero(left.nats).tolist() == [4]
    assert left.share[4] == pytest.approx(memory**2, abs=0.12)
    assert left.nats[4] == pytest.approx(-n / 2 * np.log(1 - left.share[4]))
    np.testing.assert_allclose(np.corrcoef(left.predicted[1:, 4], e[:-1, 4])[0, 1], 1, atol=0.1)


@pytest.mark.parametrize("before", [True, False])
def test_a_drift_that_was_there_before_is_nothing_new(of: Problem, before: bool) -> None:
    n, outputs = size(of)
    rng = np.random.default_rng(1)
    e = rng.normal(size=(n, outputs))
    since = rows_of(of.chunks).session >= 1
    for t in range(1, n):
        if since[t] or before:
            e[t, 4] = 0.9 * e[t - 1, 4] + np.sqrt(1 - 0.9**2) * rng.normal()
    left = whiteness_since(of, fit(of, e), 1)
    assert np.flatnonzero(left.nats).tolist() == ([] if before else [4])
    if not before:
        assert left.nats[4] == pytest.approx(-since.sum() / 2 * np.log(1 - 0.9**2), rel=0.4)


def test_rows_that_are_late_do_not_foretell(of: Problem) -> None:
    """A few large innovations, of either sign, independent."""
    rng = np.random.default_rng(2)
    e = rng.normal(size=size(of))
    e[rng.random(len(e)) < 0.1] *= 15
    assert not whiteness(of, fit(of, e)).nats.any()


def test_an_effect_is_named_by_its_share_of_what_there_is_in_its_outputs(of: Problem) -> None:
    n, outputs = size(of)
    rng, unit = np.random.default_rng(3), Noise(np.ones(outputs), np.full(outputs, 60.0))
    clean = rng.normal(size=(n, outputs))
    off = clean.copy()
    off[:, 8] += 1.5  # the effect's output: the hand's height
    drift = clean.copy()
    for t in range(1, n):
        drift[t, 11] = 0.98 * drift[t - 1, 11] + 0.2 * rng.normal()  # its vertical speed

    def share(with_it: np.ndarray, without: np.ndarray) -> float:
        a, b = (Fit(start(of), (), e, unit, float(log_density(e, unit).sum())) for e in (with_it, without))
        return named_share(SPOT.layout, a, b, whiteness(of, a).nats)

    assert share(clean, off) == 1.0
    assert share(drift, drift + off - clean) == pytest.approx(0.5, abs=0.25)  # a speed and its position are one
    elsewhere = drift[:, [*range(8), 8, 9, 11, 10]]
    assert share(elsewhere, elsewhere + off - clean) == 1.0  # what drifts is not what the effect explains
