"""Which set of effects explains the recordings: forward steps, each tested; then every member against its rivals."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.candidates import Candidate
from simgap.diagnosis.fit import (
    Fit,
    Group,
    Problem,
    constant_columns,
    evaluate,
    log_density,
    optimise,
    refine,
    side_by_side,
    whitening,
)
from simgap.diagnosis.screen import Screened, Screening, blocks, screen, vary

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


class Member(NamedTuple):
    """An effect of the set that explains the recordings.

    gain: of the set over the set without it [nats]. odds: probability of every effect id that could stand in its place.
    """

    candidate: Candidate
    gain: float
    odds: dict[str, float]


class Found(NamedTuple):
    """What the search ends with; `base` and `fit` are the models without and with the effects, fitted alike.

    rounds: every search, with the name of what it added, if anything.
    """

    problem: Problem
    base: Fit
    fit: Fit
    nuisance: Float[np.ndarray, "M n s"]
    members: tuple[Member, ...]
    rounds: list[tuple[Round, str | None]]


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
        return Round(screening, [])
    tried = side_by_side(lambda s: _try(problem, fit, nuisance, s, 3), _promising(screening.found))
    tried.sort(key=lambda t: -t.gain)

    def carry_on(t: Tried) -> Tried:
        done = refine(problem, t.fit, nuisance, 8)
        return t._replace(fit=done, gain=done.loglik - fit.loglik)

    finalists = side_by_side(carry_on, tried[:FINALISTS])
    tried = sorted([*finalists, *tried[FINALISTS:]], key=lambda t: -t.gain)
    say("tried " + ", ".join(f"{t.candidate.name} {t.gain:+.1f}" for t in tried[:4]) + " nats")
    return Round(screening, tried)


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
    v = vary(fit.v, s.candidate, s.start)
    begun = evaluate(problem, v, (*fit.groups, *s.candidate.groups), fit.noise)
    done = refine(problem, begun, nuisance, iterations)
    return Tried(s.candidate, done, done.loglik - fit.loglik)


def search(
    problem: Problem,
    fit: Fit,
    candidates: Sequence[Candidate],
    helps: Callable[[Problem, Fit, Fit], bool],
    rng: np.random.Generator,
    say: Say,
) -> Found:
    """Add effects while noise cannot explain what they gain, then let every member defend its place.

    `helps(problem, without, with_it)`: whether sessions that take no part agree.
    """
    problem, base, nuisance = refit(problem, fit)
    fit, chosen, rounds = base, [], []
    while len(chosen) < MOST_EFFECTS:
        found = one_more(problem, fit, nuisance, candidates, rng, say)
        best = found.tried[0] if found.tried else None
        so_far = fit.loglik - evaluate(problem, base.v, ()).loglik
        if best is None or best.gain < max(found.screening.threshold / 2, LEAST_SHARE * so_far):
            rounds.append((found, None))
            break
        if not helps(problem, fit, best.fit):
            say(f"{best.candidate.name} does not hold on sessions that took no part")
            rounds.append((found, None))
            break
        rounds.append((found, best.candidate.name))
        chosen.append(best.candidate)
        say(f"added {best.candidate.name} ({best.gain:+.1f} nats)")
        problem, fit, nuisance = refit(problem, best.fit)
    problem, fit, nuisance, members = _defend(problem, fit, nuisance, chosen, rounds, candidates, rng, say)
    base, _ = optimise(problem, evaluate(problem, base.v, ()), 8)
    return Found(problem, base, fit, nuisance, members, rounds)


def _defend(problem, fit, nuisance, chosen, rounds, candidates, rng, say):
    """Every member against what could stand in its place, given the others; a better one replaces it."""
    if len(chosen) == 1:
        (found, _) = rounds[0]
        return problem, fit, nuisance, (Member(chosen[0], found.tried[0].gain, odds(problem, found.tried)),)
    members: list[Member] = []
    for candidate in chosen:
        say(f"{candidate.name} against its rivals, given the other effects")
        without = _without(fit, candidate.groups)
        reduced, _ = optimise(problem, evaluate(problem, without.v, without.groups), 8)
        found = one_more(problem, reduced, nuisance, candidates, rng, say)
        own = Tried(candidate, fit, fit.loglik - reduced.loglik)
        rivals = [t for t in found.tried if t.candidate.name != candidate.name]
        if rivals and rivals[0].gain > own.gain + 1 and rivals[0].candidate.effect.id != candidate.effect.id:
            say(f"{rivals[0].candidate.name} takes the place of {candidate.name} ({rivals[0].gain - own.gain:+.1f} nats)")
            problem, fit, nuisance = refit(problem, rivals[0].fit)
            own = rivals.pop(0)
        if own.gain >= LEAST_SHARE * (fit.loglik - reduced.loglik):
            members.append(Member(own.candidate, own.gain, odds(problem, [own, *rivals])))
        rounds.append((found, None))
    return problem, fit, nuisance, tuple(members)


def _without(fit: Fit, groups: Sequence[Group]) -> Fit:
    theta, gated = fit.v.theta, fit.v.gated
    for group in groups:
        index = np.array(group.entries)
        if group.gated:
            gated = gated.at[index].set(0.0)
        else:
            theta = theta.at[index].set(0.0)
    rest = tuple(g for g in fit.groups if g not in groups)
    return fit._replace(v=fit.v._replace(theta=theta, gated=gated), groups=rest)


def odds(problem: Problem, tried: Sequence[Tried]) -> dict[str, float]:
    """Probability of each effect id, by the likelihood of its best hypothesis less log n / 2 a constant.

    The ratio of two likelihoods is itself uncertain: where its spread over blocks of rows is wider than that of a
    correct model's (variance twice the mean), the ratio is worn down accordingly [Vuong 1989].
    """
    starts, rows = blocks(np.asarray(problem.chunks.counts)), len(tried[0].fit.e)
    best: dict[str, Tried] = {}
    for t in tried:
        value = best.get(t.candidate.effect.id)
        if value is None or t.gain > value.gain:
            best[t.candidate.effect.id] = t
    score = {k: t.gain - 0.5 * len(t.candidate.groups) * np.log(rows) for k, t in best.items()}
    lead = max(score, key=lambda k: score[k])
    density = {k: log_density(t.fit.e, t.fit.noise).sum(1) for k, t in best.items()}
    logits = {}
    for k in best:
        behind = score[lead] - score[k]
        difference = np.add.reduceat(density[lead] - density[k], starts)
        spread = len(difference) * float(np.var(difference))
        logits[k] = -behind * min(1.0, 2 * behind / spread) if spread > 0 else -behind
    total = np.logaddexp.reduce(list(logits.values()))
    return {k: float(np.exp(v - total)) for k, v in sorted(logits.items(), key=lambda kv: -kv[1])}
