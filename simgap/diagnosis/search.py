"""Which set of effects explains the recordings: forward steps, each tested; then every member against its rivals."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.candidates import Candidate
from simgap.diagnosis.fit import (
    Fit,
    Problem,
    constant_columns,
    evaluate,
    optimise,
    refine,
    side_by_side,
    whitening,
)
from simgap.diagnosis.screen import Screened, Screening, _vary, screen

LEVEL = 0.004
"""Chance at which noise alone may pass for an effect, over all hypotheses together."""
LEAST_SHARE = 0.03
"""A further effect must gain this share of what all before it gained; lesser signs are told as such."""
MOST_EFFECTS = 4
FITTED = 10
"""Hypotheses that get a first fit in a round."""
FINALISTS = 4
"""Those whose fit is carried to its end."""

Say = Callable[[str], None]
"""`say(line)`: what is being tried."""


class Tried(NamedTuple):
    """A hypothesis with its constants fitted: gain in log-likelihood over the model without it [nats]."""

    candidate: Candidate
    fit: Fit
    gain: float


class Round(NamedTuple):
    """One search for one more effect: the screening, and the hypotheses that were fitted, best first."""

    screening: Screening
    tried: list[Tried]
    base: Fit

    @property
    def best(self) -> Tried | None:
        return self.tried[0] if self.tried else None


def refit(problem: Problem, fit: Fit, iterations: int = 8) -> tuple[Problem, Fit, Float[np.ndarray, "M n s"]]:
    """Fit all that is free, decorrelate the innovations anew, and fit again; returns absorbing derivatives too."""
    fit, _ = optimise(problem, fit, iterations)
    problem = problem._replace(whiten=whitening(fit.e @ np.linalg.inv(problem.whiten).T))
    fit, nuisance = optimise(problem, evaluate(problem, fit.v, fit.groups), iterations)
    return problem, fit, nuisance


def absorbing(problem: Problem, fit: Fit, nuisance: Float[np.ndarray, "M n s"]) -> Float[np.ndarray, "M n s"]:
    """Derivatives of all that is free in the model."""
    return np.concatenate([nuisance, constant_columns(problem, fit.v, fit.groups)])


def one_more(
    problem: Problem,
    fit: Fit,
    nuisance: Float[np.ndarray, "M n s"],
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    say: Say,
) -> Round:
    """Screen all hypotheses, fit the most promising, carry the best of those to the end."""
    taken = {entry for group in fit.groups for entry in group.entries}
    free = [c for c in candidates if not taken & {e for g in c.groups for e in g.entries}]
    screening = screen(problem, fit, absorbing(problem, fit, nuisance), free, LEVEL, rng)
    say(f"{len(free)} hypotheses tested: p = {screening.p_value:.4f}")
    if screening.p_value > LEVEL:
        return Round(screening, [], fit)
    tried = side_by_side(lambda s: _try(problem, fit, nuisance, s, 3), _promising(screening.found))
    tried.sort(key=lambda t: -t.gain)

    def carry_on(t: Tried) -> Tried:
        done = refine(problem, t.fit, nuisance, 8)
        return t._replace(fit=done, gain=done.loglik - fit.loglik)

    finalists = side_by_side(carry_on, tried[:FINALISTS])
    tried = sorted([*finalists, *tried[FINALISTS:]], key=lambda t: -t.gain)
    say("tried " + ", ".join(f"{t.candidate.name} {t.gain:+.1f}" for t in tried[:4]) + " nats")
    return Round(screening, tried, fit)


def _promising(found: Sequence[Screened]) -> list[Screened]:
    """The best start of the best two hypotheses of each effect, best first."""
    chosen: list[Screened] = []
    seen: set[tuple[str, str]] = set()
    for s in found:
        name = (s.candidate.effect.key, s.candidate.where)
        if s.gain < 2 or name in seen:
            continue
        if sum(c.candidate.effect.key == s.candidate.effect.key for c in chosen) < 2:
            chosen.append(s)
            seen.add(name)
        if len(chosen) == FITTED:
            break
    return chosen


def _try(problem: Problem, fit: Fit, nuisance: Float[np.ndarray, "M n s"], s: Screened, iterations: int) -> Tried:
    v = _vary(fit.v, s.candidate, s.start)
    begun = evaluate(problem, v, (*fit.groups, *s.candidate.groups), fit.noise)
    done = refine(problem, begun, nuisance, iterations)
    return Tried(s.candidate, done, done.loglik - fit.loglik)
