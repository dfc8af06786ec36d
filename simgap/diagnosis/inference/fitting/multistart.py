"""Fits of hypotheses to convergence, from all starts where the likelihood has several maxima."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.fitting.gauss_newton import HELD, RENEWALS, hold, refine
from simgap.diagnosis.inference.fitting.model import Trial, settled
from simgap.diagnosis.likelihood.derivatives import nuisance_columns
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, value_of
from simgap.threads import side_by_side

SAME_BASIN = 1 / 3
"""A fit whose constant has come this close to that of a better fit, as a share of the distance at first, leads to the
same maximum. Fits from neighbouring starts of delays and resonances mostly do after one or two sets of derivatives, and
would need four to six to get there."""


class _Climb(NamedTuple):
    """A fit on its way to a maximum. begun: value of the first constant at its start. climbs: whether it may gain."""

    trial: Trial
    begun: float
    fit: Fit
    climbs: bool = True

    @property
    def value(self) -> float:
        """Value of the first constant."""
        return value_of(self.fit.v, self.trial.hypothesis.groups[0])

    def joins(self, better: "_Climb") -> bool:
        """Whether it leads to the maximum that a better fit of the same hypothesis is closer to."""
        ahead = better.trial is self.trial and better.fit.loglik > self.fit.loglik
        return ahead and abs(self.value - better.value) <= SAME_BASIN * abs(self.begun - better.value)


def converged(problem: Problem, trials: Sequence[Trial]) -> list[Trial]:
    """The trials with their fits continued to convergence.

    An effect with basins is also fitted from every start beyond its current value. Those fits use derivatives at the
    start itself: the current ones do not lead on from there, nor do parameters that were fitted in another basin. A fit
    that joins a better one is given up.
    """
    climbs = [climb for trial in trials for climb in _begun(problem, trial)]
    for _ in range(RENEWALS):
        moved = side_by_side(lambda c: _further(problem, c) if c.climbs else c, climbs)
        climbs = [c._replace(climbs=c.climbs and not any(map(c.joins, moved))) for c in moved]
        if not any(c.climbs for c in climbs):
            break
    ends = [max((c.fit for c in climbs if c.trial is trial), key=lambda fit: fit.loglik) for trial in trials]
    return [trial.further(lambda _, end=end: end) for trial, end in zip(trials, ends, strict=True)]


def _begun(problem: Problem, trial: Trial) -> list[_Climb]:
    """The trial's own fit, and fits at the starts beyond it."""
    hypothesis, current = trial.hypothesis, value_of(trial.fit.v, trial.hypothesis.groups[0])
    climbs = [_Climb(trial, current, trial.fit)]
    if hypothesis.effect.basins:
        for start in (s for s in hypothesis.starts if s[0] > current):
            v = vary(trial.without.v, hypothesis, start)
            fit = evaluate(problem, v, trial.fit.groups, trial.without.noise)
            if np.isfinite(fit.loglik):
                climbs.append(_Climb(trial, start[0], fit))
    return climbs


def _further(problem: Problem, climb: _Climb) -> _Climb:
    """Some steps with one set of derivatives."""
    fit = climb.fit
    improved = refine(problem, fit, hold(fit, nuisance_columns(problem, fit.v)), HELD)
    return climb._replace(fit=improved, climbs=improved.loglik - fit.loglik >= settled(climb.trial.gain))
