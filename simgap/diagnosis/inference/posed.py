"""The problem that a search is given: scales, segments, an engine's tables, and the simulator as it is."""

import numpy as np

from simgap.diagnosis.hypotheses.support import Since, opened
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.fitting.starts import fitted_starts, led
from simgap.diagnosis.likelihood.linearised import tabulated
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, start, whitening
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import Chunks, cut, most_rows
from simgap.diagnosis.likelihood.unmeasured import continued
from simgap.effects.augmented import Augmented
from simgap.engines import Engine, is_engine
from simgap.types import Sessions, StepModel


def posed(
    simulator: StepModel | Engine, sessions: Sessions, ranges_hold: bool, before: Explanation | None
) -> tuple[Problem, Fit, Chunks]:
    """The problem, its fit at nominal parameters, and the held-out segments."""
    augmented = Augmented(simulator)
    scales, time_step, most = measure(augmented, sessions.fitted), simulator.time_step, most_rows(simulator)
    chunks = cut(sessions.fitted, time_step, most=most)
    if sessions.baseline:
        chunks = opened(augmented.layout, chunks, [Since(len(sessions.baseline))])
    unseen = cut(sessions.heldout, time_step, len(chunks.row), most)
    if before is not None and not augmented.layout.observed.all():
        chunks = continued(before.problem, before.fit.v, chunks)
        unseen = continued(before.problem._replace(chunks=before.unseen), before.fit.v, unseen)
    problem = Problem(augmented, scales, chunks, np.eye(len(simulator.schema.outputs)), ranges_hold)
    problem = _tabulated(problem, before)
    nominal = evaluate(problem, start(problem), ())
    problem = problem._replace(whiten=whitening(nominal.e))
    if before is None and led(problem):
        problem, fit = fitted_starts(problem, nominal)
        unseen = fitted_starts(problem._replace(chunks=unseen), fit, free=False)[0].chunks
        nominal = evaluate(problem, nominal.v, ())
    return problem, nominal, unseen


def _tabulated(problem: Problem, before: Explanation | None) -> Problem:
    """The problem with an engine tabulated at an earlier fit, or at the start; unchanged without an engine."""
    if not is_engine(problem.augmented.simulator):
        return problem
    v, gate = (start(problem), problem.chunks.gate) if before is None else (before.fit.v, before.problem.chunks.gate)
    table = tabulated(problem, v, problem.chunks._replace(gate=gate)).table
    return problem._replace(chunks=problem.chunks._replace(table=table), near=np.asarray(v.phi))
