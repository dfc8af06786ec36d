"""A fitted model, and hypotheses fitted on top of it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import LEAST_SHARE
from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.inference.gauss_newton import CONVERGED, optimise
from simgap.diagnosis.inference.score_test import Screening
from simgap.diagnosis.likelihood.derivatives import constant_columns
from simgap.diagnosis.likelihood.problem import Fit, Group, Problem, evaluate, start, whitening, with_value
from simgap.diagnosis.likelihood.student_t import log_density

SETTLED = 1.0
SETTLED_SHARE = 0.01
"""Nats, and share of a hypothesis' gain, that decide nothing beside it."""
Reporter = Callable[[str], None]
"""`say(line)`: what is being tried."""


class Model(NamedTuple):
    """A fitted model of the recordings; nuisance: derivatives of the innovations by phi and gain at the fit."""

    problem: Problem
    fit: Fit
    nuisance: Float[np.ndarray, "M n s"]


class Trial(NamedTuple):
    """A hypothesis with its constants fitted: gain in log-likelihood over the model without it [nats].

    Without a change since a baseline, the effect may be there all along: `without` has its twin fitted. expected: what
    the screening expects it to gain. share: of its gain, what the misfit of the effects before it would not explain.
    """

    hypothesis: Hypothesis
    fit: Fit
    without: Fit
    gain: float
    expected: float
    share: float = 1.0

    @staticmethod
    def of(hypothesis: Hypothesis, fit: Fit, without: Fit, expected: float = 0.0, share: float = 1.0) -> "Trial":
        """With the gain that the two fits make."""
        return Trial(hypothesis, fit, without, fit.loglik - without.loglik, expected, share)

    @property
    def beyond(self) -> float:
        """Gain [nats] beyond what the misfit of the effects before it would explain."""
        return self.share * self.gain

    @property
    def promise(self) -> float:
        """What it may gain when it is fitted to the end.

        Where an effect moves phi or the gain far, the derivatives at hand do not lead there.
        """
        return max(self.gain, self.expected)

    def further(self, fit_further: Callable[[Fit], Fit]) -> "Trial":
        """Fitted on."""
        return Trial.of(self.hypothesis, fit_further(self.fit), self.without, self.expected, self.share)


HeldOutCheck = Callable[[Problem, Trial, float], bool]
"""Whether sessions that take no part agree that an effect is there, which must gain so many nats."""


class Round(NamedTuple):
    """One search for one more effect: the screening, the hypotheses that were fitted, best first, and the addition."""

    screening: Screening
    tried: list[Trial]
    accepted: str | None = None

    @property
    def rejected(self) -> float:
        """What the best hypothesis gains [nats] where none was accepted."""
        return 0.0 if self.accepted else max((t.gain for t in self.tried), default=0.0)


class Found(NamedTuple):
    """What the forward search ends with: the models without any effect and with the chosen ones."""

    base: Fit
    model: Model
    chosen: list[Hypothesis]
    rounds: list[Round]


def decorrelated(problem: Problem, fit: Fit) -> Model:
    """The model whose innovations are decorrelated anew, by what the fit leaves over, and fitted again."""
    problem = problem._replace(whiten=whitening(fit.e @ np.linalg.inv(problem.whiten).T))
    return Model(problem, *optimise(problem, evaluate(problem, fit.v, fit.groups)))


def absorbing(model: Model) -> Float[np.ndarray, "M n s"]:
    """Derivatives of all that is free in the model."""
    problem, fit, nuisance = model
    return np.concatenate([nuisance, constant_columns(problem, fit.v, fit.groups)])


def without(fit: Fit, groups: Sequence[Group]) -> Fit:
    """The fit with some constants at zero and no longer free; nothing is fitted anew."""
    v = fit.v
    for group in groups:
        v = with_value(v, group, 0.0)
    return fit._replace(v=v, groups=tuple(g for g in fit.groups if g not in groups))


def refitted_without(model: Model, effects: Sequence[Hypothesis], enough: float = CONVERGED) -> Model:
    """The model without some of its effects, fitted anew until steps gain less than `enough` [nats].

    From nominal parameters and gain where the simulator leaves the finite numbers without these effects, and without
    any of them where it does so there as well.
    """
    problem, fit, _ = model
    rest, nominal = without(fit, [group for effect in effects for group in effect.groups]), start(problem)
    for v in (rest.v, nominal._replace(theta=rest.v.theta, delta=rest.v.delta), nominal):
        begun = evaluate(problem, v, rest.groups)
        if np.isfinite(begun.loglik):
            break
    return Model(problem, *optimise(problem, begun, enough))


def settled(gain: float) -> float:
    """Nats that decide nothing beside such a gain."""
    return max(SETTLED, SETTLED_SHARE * gain)


def least(problem: Problem, base: Fit, fit: Fit, better: Fit) -> float:
    """Least gain [nats] of a further effect: `LEAST_SHARE` of what was gained so far in the outputs it improves."""
    now, before = (log_density(f.e, f.noise).sum(0) for f in (fit, evaluate(problem, base.v, ())))
    more = np.maximum(log_density(better.e, better.noise).sum(0) - now, 0.0)
    return LEAST_SHARE * float(np.maximum(now - before, 0.0) @ more) / max(float(more.sum()), 1e-9)
