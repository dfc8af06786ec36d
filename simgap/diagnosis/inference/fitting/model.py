"""A fitted model, and hypotheses fitted on top of it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import LEAST_SHARE
from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.inference.evidence.screening import Screening
from simgap.diagnosis.inference.fitting.gauss_newton import CONVERGED, optimise
from simgap.diagnosis.likelihood.derivatives import constant_columns
from simgap.diagnosis.likelihood.problem import Fit, Group, Problem, evaluate, start, whitening, with_value
from simgap.diagnosis.likelihood.student_t import log_density

SETTLED = 1.0
SETTLED_SHARE = 0.01
"""Differences in gain below this [nats], or below this share of a hypothesis' gain, are ties."""
Reporter = Callable[[str], None]
"""`report(line)`: what is being done."""


class Model(NamedTuple):
    """A fitted model of the recordings; nuisance: derivatives of the innovations by phi and gain at the fit."""

    problem: Problem
    fit: Fit
    nuisance: Float[np.ndarray, "M n s"]

    @property
    def density(self) -> float:
        """Log-density of the innovations in their own units [nats], however they are decorrelated."""
        return self.fit.loglik + len(self.fit.e) * float(np.linalg.slogdet(self.problem.whiten)[1])


class Trial(NamedTuple):
    """A hypothesis with its constants fitted. gain: in log-likelihood over the model without it [nats].

    without: the fitted model without it. For a change since a baseline it has the twin, because the effect may act all
    along. expected: gain by the screening [nats]. share: of the gain, what misfit of earlier effects cannot explain.
    """

    hypothesis: Hypothesis
    fit: Fit
    without: Fit
    gain: float
    expected: float
    share: float = 1.0

    @staticmethod
    def of(hypothesis: Hypothesis, fit: Fit, without: Fit, expected: float = 0.0, share: float = 1.0) -> "Trial":
        """A trial with the gain of one fit over the other."""
        return Trial(hypothesis, fit, without, fit.loglik - without.loglik, expected, share)

    @property
    def beyond(self) -> float:
        """Gain [nats] beyond what misfit of the earlier effects would explain."""
        return self.share * self.gain

    @property
    def evidence(self) -> float:
        """Gain [nats] beyond what as many constants gain by chance."""
        return self.gain - cost(len(self.hypothesis.groups), len(self.fit.e))

    @property
    def promise(self) -> float:
        """Gain [nats] that it may have once its fit has converged.

        If an effect moves phi or the filter gain far, the current derivatives do not lead there.
        """
        return max(self.gain, self.expected)

    def further(self, fit_further: Callable[[Fit], Fit]) -> "Trial":
        """The trial with its fit continued."""
        return Trial.of(self.hypothesis, fit_further(self.fit), self.without, self.expected, self.share)


HeldOutCheck = Callable[[Problem, Trial, float], bool]
"""Held-out check of an effect that must gain at least `required` nats."""


class Round(NamedTuple):
    """One search for one more effect: the screening, the fitted hypotheses (best first), and the accepted one.

    p_value: that noise alone gains as much as the best, as it was screened or as it was fitted.
    """

    screening: Screening
    tried: list[Trial]
    p_value: float
    accepted: str | None = None

    @property
    def accepted_id(self) -> str | None:
        """Id of the accepted effect, if one was accepted."""
        return self.tried[0].hypothesis.effect.id if self.accepted else None

    @property
    def rejected(self) -> float:
        """Gain [nats] of the best hypothesis if none was accepted, else 0."""
        return 0.0 if self.accepted else max((t.gain for t in self.tried), default=0.0)


class Found(NamedTuple):
    """Result of the forward search: the model without effects and the one with the chosen effects."""

    base: Fit
    model: Model
    chosen: list[Hypothesis]
    rounds: list[Round]


def decorrelated(problem: Problem, fit: Fit) -> Model:
    """The model refitted with outputs that are decorrelated by its own residuals."""
    problem = problem._replace(whiten=whitening(fit.e @ np.linalg.inv(problem.whiten).T))
    return Model(problem, *optimise(problem, evaluate(problem, fit.v, fit.groups)))


def cost(constants: int, rows: int) -> float:
    """What free constants cost next to their gain [nats]: log(rows) / 2 each [Schwarz 1978]."""
    return 0.5 * constants * float(np.log(rows))


def absorbing(model: Model) -> Float[np.ndarray, "M n s"]:
    """Derivatives of the innovations by all that is free in the model."""
    problem, fit, nuisance = model
    return np.concatenate([nuisance, constant_columns(problem, fit.v, fit.groups)])


def without(fit: Fit, groups: Sequence[Group]) -> Fit:
    """The fit with some constants at zero and no longer free. Nothing is refitted."""
    v = fit.v
    for group in groups:
        v = with_value(v, group, 0.0)
    return fit._replace(v=v, groups=tuple(g for g in fit.groups if g not in groups))


def refitted_without(model: Model, effects: Sequence[Hypothesis], enough: float = CONVERGED) -> Model:
    """The model without some of its effects, refitted until iterations gain less than `enough` [nats].

    If the simulator diverges without these effects, the fit starts at nominal parameters and filter gain. If it
    diverges there as well, the fit starts without any effects.
    """
    problem, fit, _ = model
    rest, nominal = without(fit, [group for effect in effects for group in effect.groups]), start(problem)
    for v in (rest.v, nominal._replace(theta=rest.v.theta, delta=rest.v.delta), nominal):
        initial = evaluate(problem, v, rest.groups)
        if np.isfinite(initial.loglik):
            break
    return Model(problem, *optimise(problem, initial, enough))


def settled(gain: float) -> float:
    """Differences below this [nats] are ties, next to such a gain."""
    return max(SETTLED, SETTLED_SHARE * gain)


def least(problem: Problem, base: Fit, fit: Fit, better: Fit) -> float:
    """Gain [nats] required of a further effect: `LEAST_SHARE` of what was gained so far in the outputs it improves."""
    now, before = (log_density(f.e, f.noise).sum(0) for f in (fit, evaluate(problem, base.v, ())))
    improvement = np.maximum(log_density(better.e, better.noise).sum(0) - now, 0.0)
    return LEAST_SHARE * float(np.maximum(now - before, 0.0) @ improvement) / max(float(improvement.sum()), 1e-9)
