"""Refitting takes up what recordings left open, and nothing of what they determine."""

import numpy as np
from test_experiment import Pair, side_by_side
from test_numerics import optimised, posed

from simgap.diagnosis.inference.fitting.model import Model
from simgap.diagnosis.likelihood.directions import spans
from simgap.diagnosis.likelihood.problem import evaluate
from simgap.diagnosis.report.separation import Run, apart, apart_refitted
from simgap.effects.regime import EVERYWHERE
from simgap.types import Recording


def one_run(model: Model) -> Run:
    """Reversals of both carts as the fitted model predicts them, without noise."""
    simulator = model.problem.augmented.simulator
    commands = 3.0 * np.sign(np.sin(np.arange(200) / 15))[:, None] * np.ones(2)
    state, states = np.zeros(4, np.float32), []
    for u in commands:
        state = np.asarray(simulator.step(model.fit.v.phi, state, u))
        states.append(state)
    return commands, np.array(states)


def nats(rows: int, moved: float) -> tuple[float, float, float]:
    """How far apart a fit and one with another parameter are: as they are, refitted to one run, and refitted to four.

    rows: of each recording. moved: the parameter's change, as a share of its range.
    """
    sessions = [Recording(r.name, r.time_s[:rows], r.state[:rows], r.command[:rows]) for r in side_by_side()]
    model = optimised(posed(Pair(), sessions))
    problem, fit, _ = model
    phi = np.array(fit.v.phi)
    phi[0] += moved * spans(problem)[0]
    other = evaluate(problem, fit.v._replace(phi=phi), (), fit.noise)
    given = problem, fit, other, [one_run(model)], (EVERYWHERE,)
    return float(apart(*given)[0]), float(apart_refitted(*given, 1)[0]), float(apart_refitted(*given, 4)[0])


def test_what_short_recordings_left_open_is_fitted_to_the_run() -> None:
    as_it_is, refitted, _ = nats(rows=12, moved=0.1)
    assert 0 < refitted < 0.3 * as_it_is


def test_what_long_recordings_determined_stays_and_more_runs_show_it_better() -> None:
    as_it_is, refitted, four_times = nats(rows=400, moved=0.1)
    assert 0.7 * as_it_is < refitted < as_it_is
    assert 2 * refitted < four_times < 4 * as_it_is
