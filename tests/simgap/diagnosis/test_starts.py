"""Starts of unmeasured states, and the parameters that are fitted together with them."""

import numpy as np
import pytest
from tanks import FIRST, PARAMS, Tanks, recorded

from simgap.diagnosis.inference.fitting.starts import fitted_starts
from simgap.diagnosis.inference.noise.spectral_line import _share_in_innovations
from simgap.diagnosis.inference.passes import explained
from simgap.diagnosis.likelihood.problem import Fit, Problem, estimates, evaluate, start
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.unmeasured import estimated, guessed
from simgap.effects.augmented import Augmented
from simgap.types import Sessions

FAR = (0.08, 0.085, 0.08)
"""Parameters far from the nominal ones, with which the level of the upper tank is guessed."""


def begun(sessions: Sessions) -> tuple[Problem, Fit, Problem, Fit]:
    """A problem with guessed starts and its nominal fit, and both with fitted ones."""
    augmented, chunks = Augmented(Tanks()), cut(sessions.fitted, Tanks().time_step)
    problem = Problem(augmented, measure(augmented, sessions.fitted), chunks, np.eye(1))
    nominal = evaluate(problem, start(problem), ())
    return problem, nominal, *fitted_starts(problem, nominal)


@pytest.mark.parametrize("params", [PARAMS, FAR])
def test_parameters_and_starts_are_found_from_a_guess_by_wrong_parameters(params: tuple[float, ...]) -> None:
    _, _, problem, fit = begun(guessed(Tanks(), recorded(1, params=params)))
    np.testing.assert_allclose(fit.v.phi, params, rtol=0.03)
    first = (problem.chunks.row == 0) & np.asarray(problem.chunks.counts).any(1)
    np.testing.assert_allclose(np.asarray(problem.chunks.state)[first, 0, 1], FIRST, atol=0.4)


def test_segments_begin_where_the_one_before_leads() -> None:
    _, _, problem, fit = begun(guessed(Tanks(), recorded(1, params=FAR)))
    chunks, x = problem.chunks, estimates(problem, fit.v)
    following = [c for c in range(1, len(chunks.row)) if chunks.row[c] and chunks.session[c] == chunks.session[c - 1]]
    assert len(following) >= 15
    for c in following:
        rows = chunks.row[c] - chunks.row[c - 1]
        np.testing.assert_allclose(np.asarray(chunks.state)[c, 0, 1], x[c - 1, rows, 1], rtol=0.02, atol=0.2)


def test_measured_states_and_what_is_scored_stay() -> None:
    before, _, after, _ = begun(guessed(Tanks(), recorded(1)))
    np.testing.assert_array_equal(after.chunks.state[..., 0], before.chunks.state[..., 0])
    np.testing.assert_array_equal(after.chunks.counts, before.chunks.counts)


def test_a_wave_is_looked_for_in_segments_with_fitted_starts() -> None:
    _, _, problem, fit = begun(guessed(Tanks(), recorded(1)))
    assert 0.1 < _share_in_innovations(problem, fit, 0, 0.1, 0.2) < 2


def test_a_model_that_is_not_free_stays() -> None:
    problem, nominal, *_ = begun(guessed(Tanks(), recorded(1, params=FAR)))
    _, fit = fitted_starts(problem, nominal, free=False)
    np.testing.assert_array_equal(fit.v.phi, nominal.v.phi)
    assert fit.loglik > nominal.loglik


def test_estimates_of_a_session_begin_with_its_fitted_start() -> None:
    """Segments that only pad their number are copies of the first one, with the guess."""
    sessions = guessed(Tanks(), recorded(1, params=FAR))
    _, _, problem, fit = begun(sessions)
    assert not np.asarray(problem.chunks.counts).any(1).all()
    for s, recording in enumerate(estimated(problem, fit.v, sessions.fitted)):
        (chunk,) = np.flatnonzero((problem.chunks.session == s) & (problem.chunks.row == 0))[:1]
        assert recording.state[0, 1] == pytest.approx(float(problem.chunks.state[chunk, 0, 1]))


@pytest.mark.parametrize("seed", range(3))
def test_parameters_far_from_nominal_are_no_scale_of_the_sensor(seed: int) -> None:
    """Fitted in turns with the starts, parameters stop half-way, where a scale of the sensor gains hundreds of nats."""
    found, _ = explained(Tanks(), recorded(seed, params=FAR, noise=0.01), np.random.default_rng(0), print)
    assert not found.members
    np.testing.assert_allclose(found.fit.v.phi, FAR, rtol=0.03)
