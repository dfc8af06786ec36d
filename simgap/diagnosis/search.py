"""Which set of effects explains the recordings: forward steps, each tested; then every member against its rivals."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
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
    trials,
    whitening,
)
from simgap.diagnosis.innovations import Variables
from simgap.diagnosis.screen import Screened, Screening, blocks, screen, vary

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

    gain: of the set over the set without it [nats]. odds: probability of every effect id that could stand in its place;
    rival: the best hypothesis of another id, fitted; without: the model that lacks it, fitted.
    """

    candidate: Candidate
    gain: float
    odds: dict[str, float]
    rival: Tried | None
    without: Fit


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
        # An effect moves the gain far at times: the derivatives held so far no longer lead uphill then.
        done, _ = optimise(problem, refine(problem, t.fit, nuisance, 4), 6)
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
    if s.candidate.effect.jagged:
        v = _summit(problem, fit, s)
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
    while len({c.effect.id for c in chosen}) < MOST_EFFECTS and len(chosen) < MOST_SITES:
        found = one_more(problem, fit, nuisance, candidates, rng, say)
        owed = found.screening.threshold / 2
        worthy = [t for t in found.tried if t.gain > max(owed, _least(problem, base, fit, t.fit))]
        best = next((t for t in worthy if helps(problem, fit, t.fit)), None)
        for t in worthy[: worthy.index(best)] if best else worthy:
            say(f"{t.candidate.name} does not hold on sessions that took no part")
        rounds.append((found, best and best.candidate.name))
        if best is None:
            break
        chosen.append(best.candidate)
        # Rivals are compared with what was chosen, the best that holds.
        found.tried.sort(key=lambda t: (t is not best, -t.gain))
        say(f"added {best.candidate.name} ({best.gain:+.1f} nats)")
        problem, fit, nuisance = refit(problem, best.fit)
    problem, fit, nuisance, members = _defend(problem, fit, nuisance, chosen, rounds, candidates, rng, say, base)
    base, _ = optimise(problem, evaluate(problem, base.v, ()), 8)
    return Found(problem, base, fit, nuisance, members, rounds)


def _least(problem: Problem, base: Fit, fit: Fit, better: Fit) -> float:
    """Gain [nats] that a further effect owes: `LEAST_SHARE` of what was gained so far in the outputs it improves."""
    now, before = (log_density(f.e, f.noise).sum(0) for f in (fit, evaluate(problem, base.v, ())))
    more = np.maximum(log_density(better.e, better.noise).sum(0) - now, 0.0)
    return LEAST_SHARE * float(np.maximum(now - before, 0.0) @ more) / max(float(more.sum()), 1e-9)


def _defend(problem, fit, nuisance, chosen, rounds, candidates, rng, say, base):
    """Every member against what could stand in its place, given the others; a better one replaces it."""
    if len(chosen) == 1:
        (found, _) = rounds[0]
        return problem, fit, nuisance, (_member(problem, found.tried, base),)
    members: list[Member] = []
    for candidate in chosen:
        say(f"{candidate.name} against its rivals, given the other effects")
        rest = _without(fit, candidate.groups)
        reduced, absorbed = optimise(problem, evaluate(problem, rest.v, rest.groups), 8)
        found = one_more(problem, reduced, absorbed, candidates, rng, say)
        rounds.append((found, None))
        own = Tried(candidate, fit, fit.loglik - reduced.loglik)
        rivals = [t for t in found.tried if t.candidate.name != candidate.name]
        if rivals and rivals[0].gain > own.gain + 1 and rivals[0].candidate.effect.id != candidate.effect.id:
            say(f"{rivals[0].candidate.name} replaces {candidate.name} ({rivals[0].gain - own.gain:+.1f} nats)")
            fit, nuisance = optimise(problem, rivals[0].fit, 8)
            own = rivals.pop(0)
        if own.gain < max(found.screening.threshold / 2, _least(problem, base, reduced, fit)):
            say(f"{candidate.name} is not needed beside the others")
            fit, nuisance = reduced, absorbed
        else:
            members.append(_member(problem, [own, *rivals], reduced))
    return problem, fit, nuisance, tuple(members)


def _member(problem: Problem, tried: Sequence[Tried], without: Fit) -> Member:
    """The first of the hypotheses tried for one place, with the others as its rivals."""
    own = tried[0]
    rival = next((t for t in tried if t.candidate.effect.id != own.candidate.effect.id), None)
    return Member(own.candidate, own.gain, odds(problem, tried), rival, without)


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
    """Probability of each effect id against the first's, by their best hypotheses' likelihood less log n / 2 a constant.

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
    lead = tried[0].candidate.effect.id
    density = {k: log_density(t.fit.e, t.fit.noise).sum(1) for k, t in best.items()}
    logits = {}
    for k in best:
        behind = max(score[lead] - score[k], 0.0)
        difference = np.add.reduceat(density[lead] - density[k], starts)
        spread = len(difference) * float(np.var(difference))
        logits[k] = -behind * min(1.0, 2 * behind / spread) if spread > 0 else -behind
    total = np.logaddexp.reduce(list(logits.values()))
    return {k: float(np.exp(v - total)) for k, v in sorted(logits.items(), key=lambda kv: -kv[1])}


def _summit(problem: Problem, fit: Fit, s: Screened) -> Variables:
    """The best of many constants near the start, where derivatives lead nowhere."""
    near = [vary(fit.v, s.candidate, [c * share for c in s.start]) for share in np.linspace(0.9, 1.1, 36)]
    e = trials(problem, jax.tree.map(lambda *a: jnp.stack(a), *near))
    return near[int(np.argmax([log_density(one, fit.noise).sum() for one in e]))]
