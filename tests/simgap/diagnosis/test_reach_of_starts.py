"""Laws that are no multiple of their constant are looked for over all of its range."""

from types import ModuleType

import numpy as np
import pytest
from test_numerics import known, optimised, posed
from test_ranges import driven

from examples.drive import Drive
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.fitting import gauss_newton, multistart
from simgap.diagnosis.inference.fitting.model import Trial, settled
from simgap.diagnosis.inference.search import posterior
from simgap.diagnosis.inference.search.one_more import one_more
from simgap.diagnosis.likelihood.problem import evaluate
from simgap.effects import CATALOGUE
from simgap.effects.effect import HISTORY_ROWS, SENSED_ROWS
from simgap.types import Recording


@pytest.mark.parametrize(
    ("key", "furthest", "gap"), [("sensor_delay", SENSED_ROWS, 1.0), ("delay", HISTORY_ROWS, 2.0), ("lag", 30, 17.0)]
)
def test_starts_reach_as_far_as_the_bound(key: str, furthest: float, gap: float) -> None:
    of = posed(Drive(), driven((2.5, 5.0)))
    (effect,) = (e for e in CATALOGUE if e.key == key)
    assert effect.constants[0].high == furthest
    starts = [0.0, *(start for (start,) in effect.starts(of.scales, 0)), furthest]
    assert max(np.diff(starts)) <= gap


def late(recordings: list[Recording], rows: float) -> list[Recording]:
    """Sessions whose velocity was measured so many rows before its time stamp."""
    found = []
    for r in recordings:
        time = np.arange(len(r.time_s))
        velocity = np.interp(time - rows, time, r.state[:, 1])
        found.append(r._replace(state=np.stack([r.state[:, 0], velocity], axis=1)))
    return found


@pytest.mark.parametrize("rows", [0.7, 2.2, 3.5])
def test_an_old_measurement_is_recovered_within_its_interval(rows: float) -> None:
    model = optimised(posed(Drive(), late(driven((2.5, 5.0)), rows)))
    delay = known(model.problem, "sensor_delay on cart velocity")
    (tried,) = one_more(model, [delay], np.random.default_rng(0), print).tried
    assert tried.gain > 50
    (found,) = posterior.constants(
        model.problem, tried.fit, delay, posterior.spread(model.problem, tried.fit, model.nuisance), tried.gain
    )
    low, high = found["ci95"]
    assert low <= rows * Drive().time_step <= high
    assert high - low < Drive().time_step


def counted(monkeypatch: pytest.MonkeyPatch, module: ModuleType) -> list[int]:
    """One entry for each set of derivatives that a module asks for from now on."""
    sets: list[int] = []
    whole = module.nuisance_columns
    monkeypatch.setattr(module, "nuisance_columns", lambda *given: sets.append(1) or whole(*given))
    return sets


@pytest.mark.parametrize("rows", [0.7, 2.2, 3.5])
def test_fits_that_join_a_better_one_lose_nothing(rows: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Next to fits that all go on to the end, from every start alone."""
    problem, fit, _ = optimised(posed(Drive(), late(driven((2.5, 5.0)), rows)))
    delay = known(problem, "sensor_delay on cart velocity")
    begun = [evaluate(problem, vary(fit.v, delay, start), delay.groups, fit.noise) for start in delay.starts]
    alone, together = counted(monkeypatch, gauss_newton), counted(monkeypatch, multistart)
    ends = [gauss_newton.optimise(problem, f)[0].loglik for f in begun if np.isfinite(f.loglik)]
    (end,) = multistart.converged(problem, [Trial.of(delay, begun[0], fit)])
    assert max(ends) - min(ends) > 50 or rows < 1  # starts that lead elsewhere, without which this would test nothing
    assert end.fit.loglik > max(ends) - settled(max(ends) - fit.loglik)
    assert 0 < len(together) < len(alone)
