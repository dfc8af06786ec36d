"""Whether held-out sessions show what the fitted ones do not: "nothing is missing" is a claim about both."""

import numpy as np

from simgap.diagnosis.config import LEVEL
from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.inference.evidence.score_test import screen
from simgap.diagnosis.inference.evidence.screening import Screened
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.fitting.model import Model, absorbing
from simgap.diagnosis.inference.misfit.relaxation import room
from simgap.diagnosis.likelihood.problem import evaluate


def heldout_only(found: Explanation, rng: np.random.Generator) -> Screened | None:
    """The hypothesis that held-out sessions support most, if fitted ones support none.

    None if chance may explain it, or other parameters and another filter gain: both are fitted to these sessions first,
    as the others may determine them badly. Nor is it looked for where the fitted sessions show something, or with a
    baseline.
    """
    if found.anything or found.noise_effects or found.baseline:
        return None
    problem = found.problem._replace(chunks=found.unseen)
    initial = evaluate(problem, found.fit.v, ())
    if not np.isfinite(initial.loglik):
        return None
    model = Model(problem, *optimise(problem, initial))
    free = room(model, absorbing(model), ()).free
    screening = screen(problem, model.fit, free, hypotheses_of(problem.augmented, problem.scales), rng)
    return max(screening.found, key=lambda s: s.statistic) if screening.p_value <= LEVEL else None
