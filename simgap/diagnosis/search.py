"""Which effects explain the recordings: one more at a time, while noise cannot explain what the best of them gains."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.candidates import Candidate
from simgap.diagnosis.fit import (
    HELD,
    Fit,
    Group,
    Problem,
    constant_columns,
    evaluate,
    log_density,
    optimise,
    refine,
    replaced,
    side_by_side,
    trials,
    whitening,
)
from simgap.diagnosis.innovations import Variables
from simgap.diagnosis.screen import Screened, Screening, screen, vary

LEVEL = 0.004
"""Chance at which noise alone may pass for an effect, over all hypotheses together."""
LEAST_SHARE = 0.03
"""A further effect must gain this share of what those before it gained in the same outputs: less may be no more than
the difference between their laws and the robot's."""
MOST_EFFECTS = 4
MOST_SITES = 6
"""An effect that acts at several sites with several constants takes a step for each."""
FITTED = 10
"""Hypotheses that get a first fit in a round."""
FINALISTS = 4
"""Those whose fit is carried on,"""
SHARES = tuple(np.geomspace(1, 0.02, 8))
"""Of the amplitude that the screening expects, where a fit may start."""
CONTENDER = 0.5
"""and to its end where it gains this share of what the best gains."""
SETTLED = 1.0
SETTLED_SHARE = 0.01
"""Nats, and share of its gain, below which what a finalist still gains decides nothing."""

Say = Callable[[str], None]
"""`say(line)`: what is being tried."""

Helps = Callable[[Problem, Fit, Fit], bool]
"""`helps(problem, without, with_it)`: whether sessions that take no part agree that an effect is there."""


class Model(NamedTuple):
    """A fitted model of the recordings; nuisance: derivatives of the innovations by phi and gain at the fit."""

    problem: Problem
    fit: Fit
    nuisance: Float[np.ndarray, "M n s"]


class Tried(NamedTuple):
    """A hypothesis with its constants fitted: gain in log-likelihood over the model without it [nats].

    Without a change since a baseline, the effect may be there all along: `without` has its twin fitted.
    """

    candidate: Candidate
    fit: Fit
    without: Fit
    gain: float

    @staticmethod
    def of(candidate: Candidate, fit: Fit, without: Fit) -> "Tried":
        """With the gain that the two fits make."""
        return Tried(candidate, fit, without, fit.loglik - without.loglik)


class Round(NamedTuple):
    """One search for one more effect: the screening, the hypotheses that were fitted, best first, and the addition."""

    screening: Screening
    tried: list[Tried]
    accepted: str | None = None


class Found(NamedTuple):
    """What the forward search ends with: the models without any effect and with the chosen ones."""

    base: Fit
    model: Model
    chosen: list[Candidate]
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
    theta, gated = fit.v.theta, fit.v.gated
    for group in groups:
        if group.gated:
            gated = replaced(gated, group.entries, 0.0)
        else:
            theta = replaced(theta, group.entries, 0.0)
    rest = tuple(g for g in fit.groups if g not in groups)
    return fit._replace(v=fit.v._replace(theta=theta, gated=gated), groups=rest)


def least(problem: Problem, base: Fit, fit: Fit, better: Fit) -> float:
    """Gain [nats] that a further effect owes: `LEAST_SHARE` of what was gained so far in the outputs it improves."""
    now, before = (log_density(f.e, f.noise).sum(0) for f in (fit, evaluate(problem, base.v, ())))
    more = np.maximum(log_density(better.e, better.noise).sum(0) - now, 0.0)
    return LEAST_SHARE * float(np.maximum(now - before, 0.0) @ more) / max(float(more.sum()), 1e-9)


def one_more(model: Model, candidates: Sequence[Candidate], rng: np.random.Generator, say: Say) -> Round:
    """Screen all hypotheses, fit the most promising, carry the best of those to the end."""
    problem, fit, _ = model
    taken = {(entry, group.gated) for group in fit.groups for entry in group.entries}
    free = [c for c in candidates if not taken & {(e, g.gated) for g in c.groups for e in g.entries}]
    held = absorbing(model)
    screening = screen(problem, fit, held, free, LEVEL, rng)
    say(f"{len(free)} hypotheses tested: p = {screening.p_value:.4f}")
    if screening.p_value > LEVEL:
        return Round(screening, [])
    tried = side_by_side(lambda s: _try(problem, fit, held, s, 3), _promising(screening.found))
    # Where an effect and phi have to move together the derivatives at hand do not lead there: what the screening
    # expects most of is fitted to the end.
    expected = tried[0].candidate if tried else None
    tried.sort(key=lambda t: (t.candidate is not expected, -t.gain))

    def further(t: Tried, fit_further: Callable[[Fit], Fit]) -> Tried:
        return Tried.of(t.candidate, fit_further(t.fit), t.without)

    finalists = side_by_side(lambda t: further(t, lambda f: refine(problem, f, held, HELD)), tried[:FINALISTS])
    # An effect moves the gain far at times: the derivatives held so far no longer lead uphill then.
    far = CONTENDER * max((t.gain for t in finalists), default=0.0)

    def to_its_end(t: Tried) -> Tried:
        if t.gain < far and t.candidate is not expected:
            return t
        enough = max(SETTLED, SETTLED_SHARE * t.gain)
        return further(t, lambda f: optimise(problem, f, enough)[0])

    finalists = side_by_side(to_its_end, finalists)
    tried = sorted([*finalists, *tried[FINALISTS:]], key=lambda t: -t.gain)
    say("tried " + ", ".join(f"{t.candidate.name} {t.gain:+.1f}" for t in tried[:4]) + " nats")
    return Round(screening, tried)


def _promising(found: Sequence[Screened]) -> list[Screened]:
    """The best start of the best two hypotheses of each effect, best first."""
    chosen: list[Screened] = []
    seen: set[tuple[str, bool, str]] = set()
    for s in found:
        key = (s.candidate.effect.key, bool(s.candidate.twin))
        name = (*key, s.candidate.where)
        if s.gain < 2 or name in seen:
            continue
        if sum((c.candidate.effect.key, bool(c.candidate.twin)) == key for c in chosen) < 2:
            chosen.append(s)
            seen.add(name)
        if len(chosen) == FITTED:
            break
    return chosen


def _try(problem: Problem, fit: Fit, held: Float[np.ndarray, "M n s"], s: Screened, iterations: int) -> Tried:
    v = _highest(problem, fit, s)
    twin = tuple(g for g in s.candidate.twin if g not in fit.groups)
    begun = evaluate(problem, v, (*fit.groups, *twin, *s.candidate.groups), fit.noise)
    done, rest = refine(problem, begun, held, iterations), fit
    if twin:
        there = vary(fit.v, s.candidate._replace(groups=s.candidate.twin), s.start)
        begun = evaluate(problem, there, (*fit.groups, *twin), fit.noise)
        rest = max(fit, refine(problem, begun, held, iterations + HELD), key=lambda f: f.loglik)
    return Tried.of(s.candidate, done, rest)


def _highest(problem: Problem, fit: Fit, s: Screened) -> Variables:
    """The likeliest of several constants: near the start where derivatives lead nowhere, else between nil and there,
    for what the screening expects of an amplitude may lie beyond the summit."""
    constants = s.candidate.effect.constants
    if s.candidate.effect.jagged:
        near = [tuple(c * share for c in s.start) for share in np.linspace(0.9, 1.1, 36)]
    else:
        near = [
            tuple(c if of.shapes else c * share for of, c in zip(constants, s.start, strict=True)) for share in SHARES
        ]
    vs = [vary(fit.v, s.candidate, constants) for constants in near]
    logliks = [log_density(one, fit.noise).sum() for one in trials(problem, vs)]
    return vs[int(np.argmax(np.nan_to_num(logliks, nan=-np.inf)))]


def search(
    problem: Problem,
    fit: Fit,
    candidates: Sequence[Candidate],
    helps: Helps,
    rng: np.random.Generator,
    say: Say,
) -> Found:
    """Add effects one by one, each the best of those that are more than noise and that held-out sessions agree to."""
    model = decorrelated(problem, optimise(problem, fit)[0])
    base, chosen, rounds = model.fit, [], []
    while len({c.effect.id for c in chosen}) < MOST_EFFECTS and len(chosen) < MOST_SITES:
        found = one_more(model, candidates, rng, say)
        owed = found.screening.threshold / 2
        worthy = [t for t in found.tried if t.gain > max(owed, least(model.problem, base, model.fit, t.fit))]
        best = next((t for t in worthy if helps(model.problem, t.without, t.fit)), None)
        for t in worthy[: worthy.index(best)] if best else worthy:
            say(f"{t.candidate.name} does not hold on sessions that took no part")
        if best is None:
            rounds.append(found)
            break
        # Rivals are compared with what was chosen, the best that holds.
        tried = sorted(found.tried, key=lambda t: (t is not best, -t.gain))
        rounds.append(found._replace(tried=tried, accepted=best.candidate.name))
        chosen.append(best.candidate)
        say(f"added {best.candidate.name} ({best.gain:+.1f} nats)")
        model = decorrelated(model.problem, best.fit)
    return Found(base, model, chosen, rounds)
