"""Sensors that lose the sign. Fitted without such an effect, parameters go where the sign no longer matters, and no
derivative leads back from there. So these hypotheses are fitted from the nominal parameters."""

from collections.abc import Sequence

import numpy as np

from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.hypotheses.support import ALWAYS
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.fitting.model import Model, Trial
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, start
from simgap.diagnosis.likelihood.signs import signed

BELOW_ZERO = 0.1
"""Greatest size of negative values, as a share of that of positive ones, that noise may give a sensor without sign."""


def without_sign(model: Model, hypotheses: Sequence[Hypothesis]) -> Trial | None:
    """The best hypothesis that a sensor loses the sign, throughout, fitted. None if none gains, or next to effects.

    Only sensors that show hardly any negative value may have lost the sign.
    """
    problem, fit, _ = model
    throughout = [h for h in hypotheses if h.effect.folds and h.support == ALWAYS]
    possible = [h for h in throughout if _never_negative(problem, h)]
    if fit.groups or not possible:
        return None
    nominal, tried = evaluate(problem, start(problem), ()), []
    for hypothesis in possible:
        v = vary(nominal.v, hypothesis, hypothesis.starts[0])
        begun = _begun(problem, nominal._replace(v=v, groups=hypothesis.groups))
        if begun[1].loglik > nominal.loglik:
            begun = _begun(begun[0], optimise(*begun)[0])
            tried.append(Trial.of(hypothesis, optimise(*begun)[0], fit))
    return max(tried, key=lambda t: t.evidence, default=None)


def _begun(problem: Problem, fit: Fit) -> tuple[Problem, Fit]:
    """The problem with the signs at its starts that suit the fit, and the fit there."""
    problem = signed(problem, fit.v)
    return problem, evaluate(problem, fit.v, fit.groups)


def _never_negative(problem: Problem, hypothesis: Hypothesis) -> bool:
    """Whether its sensors show hardly any negative value."""
    y = np.asarray(problem.chunks.state)[np.asarray(problem.chunks.counts).any(1)][..., list(hypothesis.sites)]
    low, high = np.quantile(y, [0.01, 0.95], axis=(0, 1))
    return bool((low > -BELOW_ZERO * high).all())
