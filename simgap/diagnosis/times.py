"""Whether effects act throughout: from a time on, during a stretch of one session, in a regime, or as a push."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from simgap.diagnosis.candidates import Candidate, gated, within_session
from simgap.diagnosis.fit import Fit, Problem, evaluate, hold, optimise, refine, trials
from simgap.diagnosis.heldout import gain, seen_at
from simgap.diagnosis.innovations import Chunks
from simgap.diagnosis.restricted import narrowest, of_rows
from simgap.diagnosis.rivals import Member, member
from simgap.diagnosis.screen import Evidence, Screened, Screening, Weighed, blocks, by_chance, vary, weigh
from simgap.diagnosis.search import LEAST_SHARE, LEVEL, Model, Say, Tried, lacking, one_more, without
from simgap.diagnosis.when import (
    LASTING,
    PUSH,
    Rows,
    When,
    at_start,
    elsewhere,
    gate,
    onset,
    rows_of,
    scores,
    stretch,
    stretch_by_chance,
    to_its_end,
    told,
)
from simgap.effects.regime import features

OWED = 8.0
"""Gain [nats] that an effect's beginning and end owe: two numbers, the best of some hundreds tried,"""
OWED_BY_REGIMES = 16.0
"""and a regime, the best of thousands."""
LATER = tuple(np.arange(0.0, 0.95, 0.15))
"""Shares of a session after which an effect may begin, where it is first looked for."""
PARTS = (0.35, 0.65)
"""Shares of the rows above and below which a regime may begin, where it is first looked for."""
CLEARLY = 1.1
"""Times the gain of a push that something else must gain which acts as long."""
EXCEPTION = 3.0
"""Times the gain of the best other stretch that a push must gain."""


class _Restriction(NamedTuple):
    """When a hypothesis may act, what that promises over the members as they are [nats], and the model it is in."""

    promise: float
    when: When
    candidate: Candidate
    model: Model


def acts_when(model: Model, members: tuple[Member, ...], unseen: Chunks, say: Say) -> When | None:
    """When the first effect acts that fits better from a time on, during a stretch of one session, or in a regime.

    None if none does. A regime is a law of the robot's, to which held-out sessions must agree.
    """
    problem, layout = model.problem, model.problem.augmented.layout
    for hypotheses in _ways(model, members):
        # Those with shapes have an onset of their own.
        free = [(m, c) for m, c in hypotheses if not any(constant.shapes for constant in c.effect.constants)]
        tried = [r for m, c in free for r in _restrictions(m, c, model.fit.loglik)]
        best = max(tried, key=lambda r: r.promise - _owed(r.when), default=None)
        if best is None or best.promise <= _owed(best.when):
            continue
        restricted = _behind_gate(_open(best.model, best.when), best.candidate)
        more = restricted.loglik - model.fit.loglik
        seen = seen_at(layout, unseen, best.when)
        if more > _owed(best.when) and (best.when.regime is None or gain(problem, seen, model.fit, restricted) > 0):
            say(f"{best.candidate.name} acts {told(layout, best.when)} ({more:+.1f} nats)")
            return best.when
    return None


def _ways(model: Model, members: tuple[Member, ...]) -> Iterator[list[tuple[Model, Candidate]]]:
    """What may be restricted: the first member alone, for the others may do no more than undo it where it does not act;
    then every member among the others, with its nearest rival, which it may beat for acting throughout only."""
    if len(members) > 1:
        first, *others = (m.candidate for m in members)
        yield [(lacking(model, others), first)]
    for m in members:
        hypotheses = [(model, m.candidate)]
        if m.rival is not None:
            fit = evaluate(model.problem, m.rival.fit.v, m.rival.fit.groups)
            hypotheses.append((model._replace(fit=fit), m.rival.candidate))
        yield hypotheses


def _restrictions(model: Model, candidate: Candidate, loglik: float) -> list[_Restriction]:
    """From a time on, during a stretch, in a regime: a hypothesis fitted as if it acted throughout."""
    problem, fit, _ = model
    rows, found = rows_of(problem.chunks), _apart(problem, candidate)
    score, power = scores(fit, evaluate(problem, without(fit, candidate.groups).v, (), fit.noise).e, fit.e)
    from_on, a = onset(rows, score, power)
    during, b = stretch(rows, score, power, LASTING)
    regime, c = narrowest(found, score, power, LEAST_SHARE)
    throughout, ahead = 0.5 * score.sum() ** 2 / max(power.sum(), 1e-9), fit.loglik - loglik
    whens = ((from_on, a), (during, b - throughout), (When(regime=regime), c))
    return [_Restriction(ahead + more, when, candidate, model) for when, more in whens]


class _Look(NamedTuple):
    """Rows in which effects are weighed anew: in a regime, or from a time on in one session or (None) in every."""

    rows: Bool[np.ndarray, " n"]
    session: int | None = None
    regime: bool = False


def begins(model: Model, screening: Screening, rng: np.random.Generator, say: Say) -> When | None:
    """From when on, or in which regime, an effect acts that is nothing over all rows; None if by chance.

    The screening's hypotheses are weighed anew over what comes after some times, and above and below some edges.
    """
    problem = model.problem
    rows, found = rows_of(problem.chunks), of_rows(problem.augmented.layout, problem.chunks)
    score, power, two_sided = screening.evidence
    starts = blocks(np.asarray(problem.chunks.counts))
    looks = [*_later(rows), *_beyond(found)]
    # One by one: all rows for all of these looks would be gigabytes.
    each = [weigh(Evidence(score * look.rows, power * look.rows, two_sided), starts) for look in looks]
    weighed = Weighed(*(np.concatenate(fields) for fields in zip(*each, strict=True)))
    p_value, threshold = by_chance(weighed, LEVEL, rng)
    say(f"the same from a time on, or in a regime: p = {p_value:.4f}")
    statistic, of_regimes = weighed.statistic.reshape(len(looks), -1), np.array([look.regime for look in looks])
    tried = []
    for kind in (of_regimes, ~of_regimes):  # what acts from a time on shows in some regimes, and the other way round
        among = np.where(kind[:, None], statistic, 0.0)
        if among.max() >= threshold:
            which, best = divmod(int(among.argmax()), len(score))
            tried.append(_begun(model, screening.found[best], looks[which]))
    best = max(tried, key=lambda r: r.promise - _owed(r.when), default=None)
    if best is None or best.promise <= _owed(best.when):
        return None
    say(f"{best.candidate.name} acts {told(problem.augmented.layout, best.when)} ({best.promise:+.1f} nats)")
    return best.when


def _begun(model: Model, hypothesis: Screened, look: _Look) -> _Restriction:
    """When a hypothesis acts that shows in a look: it promises what it gains there, if the restriction is worth it."""
    problem, fit, nuisance = model
    there = trials(problem, [vary(fit.v, hypothesis.candidate, hypothesis.start)])[0]
    evidence = scores(fit, fit.e, there)
    if look.regime:
        regime, more = narrowest(_apart(problem, hypothesis.candidate), *evidence, LEAST_SHARE)
        when = When(regime=regime)
    else:
        rows = rows_of(problem.chunks)
        when, more = onset(rows, *evidence, look.session)
        if look.session is not None:  # to its end
            last = rows.time_s[rows.session == look.session].max()
            when = when._replace(to_s=float(last) + problem.scales.time_step)
    if more <= _owed(when):
        return _Restriction(0.0, when, hypothesis.candidate, model)
    opened, candidate = _open(model, when).problem, gated(hypothesis.candidate)
    begun = evaluate(opened, vary(fit.v, candidate, hypothesis.start), (*fit.groups, *candidate.groups), fit.noise)
    return _Restriction(refine(opened, begun, hold(fit, nuisance), 4).loglik - fit.loglik, when, candidate, model)


def _owed(when: When) -> float:
    return OWED if when.regime is None else OWED_BY_REGIMES


def _apart(problem: Problem, candidate: Candidate) -> Float[np.ndarray, "n f"]:
    """The features of every row, those of the commands that the effect acts on made one value: an effect that differs
    with its own command is no other regime but another law."""
    layout = problem.augmented.layout
    own = [c for c in (f.name for f in layout.schema.command) if c in (*candidate.channels, *candidate.where.split())]
    told_by = np.array([f.name.strip("|") in own for f in features(layout)])
    return np.where(told_by, 0.0, of_rows(layout, problem.chunks))


def _later(rows: Rows) -> Iterator[_Look]:
    """After some times, in every session and in each."""
    for session in (None, *np.unique(rows.session).tolist()):
        mine = np.full(len(rows.time_s), True) if session is None else rows.session == session
        for share in LATER:
            if share or session is not None:
                yield _Look(mine & (rows.time_s >= share * rows.time_s[mine].max()), session)


def _beyond(found: Float[np.ndarray, "n f"]) -> Iterator[_Look]:
    """Above and below some edges of every feature."""
    for column in found.T:
        for edge in np.quantile(column, PARTS):
            yield _Look(column > edge, regime=True)
            yield _Look(column <= edge, regime=True)


class _Push(NamedTuple):
    """An event and its best stretch: what it may gain there [nats], and with which constants."""

    event: Candidate
    constants: tuple[float, ...]
    when: When
    gain: float
    score: Float[np.ndarray, " n"]
    power: Float[np.ndarray, " n"]


def pushed(
    model: Model,
    members: tuple[Member, ...],
    events: Sequence[Candidate],
    throughout: Sequence[Candidate],
    rng: np.random.Generator,
    say: Say,
) -> tuple[Model, tuple[Member, ...]]:
    """A push during a stretch of one session, if one is more than the best of all stretches by chance.

    Or what else explains that stretch, where it does so clearly better.
    """
    problem, fit, _ = model
    rows = rows_of(problem.chunks)
    tried = [_push(model, rows, event, start) for event in events for start in event.starts]
    if not tried or any(m.when for m in members):
        return model, members
    best = max(tried, key=lambda p: p.gain)
    chance = stretch_by_chance(rows, best.score, best.power, LEVEL / len(tried), rng)
    if best.gain < chance + LEAST_SHARE * sum(m.gain for m in members):
        return model, members
    # A push is an exception: what recurs is something else.
    again = max(stretch(rows, elsewhere(rows, best.when, p.score), p.power, PUSH)[1] for p in tried)
    if best.gain < EXCEPTION * again:
        return model, members
    when = best.when
    drifts, pushes = within_session(throughout, events, to_its_end(rows, when))
    alike = (c for c in (*pushes, *drifts) if c.effect.law is best.event.effect.law and c.sites == best.event.sites)
    named = next(alike)
    there, candidate = _open(model, when), gated(named)
    begun = evaluate(there.problem, vary(fit.v, candidate, best.constants), (*fit.groups, *candidate.groups), fit.noise)
    after = Model(there.problem, *optimise(there.problem, begun))
    push = Tried.of(candidate, after.fit, fit)
    say(f"{named.name} from {when.from_s:.1f} to {when.to_s:.1f} s of one session ({push.gain:+.1f} nats)")
    others = [gated(c) for c in drifts if c is not named]
    found = [push, *one_more(there, others, rng, say).tried]
    if len(found) > 1 and found[1].gain > CLEARLY * push.gain + OWED:
        say(f"{found[1].candidate.name} explains that stretch better ({found[1].gain - push.gain:+.1f} nats)")
        found[:2] = found[1], push
        after = Model(there.problem, *optimise(there.problem, found[0].fit))
    return after, (*members, member(there.problem, found, fit)._replace(when=when))


def _push(model: Model, rows: Rows, event: Candidate, start: tuple[float, ...]) -> _Push:
    """The stretch that an event's start explains best."""
    problem, fit, _ = model
    score, power = scores(fit, fit.e, trials(problem, [vary(fit.v, event, start)])[0])
    when, gain = stretch(rows, score, power, PUSH)
    while gain > 0 and at_start(rows, when):
        # What a robot remembers of the time before its session looks like a push, and is not known.
        score = elsewhere(rows, when, score)
        when, gain = stretch(rows, score, power, PUSH)
    acts = (rows.session == when.session) & (rows.time_s >= when.from_s) & (rows.time_s < when.to_s)
    amplitude = score[acts].sum() / max(power[acts].sum(), 1e-9)
    constants = [c if of.shapes else amplitude * c for of, c in zip(event.effect.constants, start, strict=True)]
    low, _ = problem.augmented.bounds
    possible = all(c >= low[g.entries[0]] for c, g in zip(constants, event.groups, strict=True))
    return _Push(event, tuple(map(float, constants)), when, gain if possible else 0.0, score, power)


def _open(model: Model, when: When) -> Model:
    layout, chunks = model.problem.augmented.layout, model.problem.chunks
    return model._replace(problem=model.problem._replace(chunks=chunks._replace(gate=gate(layout, chunks, when))))


def _behind_gate(model: Model, throughout: Candidate) -> Fit:
    """The fit with an effect's constants moved behind the gate."""
    problem, fit, nuisance = model
    candidate = gated(throughout)
    constants = [float(fit.v.theta[g.entries[0]]) for g in throughout.groups]
    rest = without(fit, throughout.groups)
    begun = evaluate(problem, vary(rest.v, candidate, constants), (*rest.groups, *candidate.groups), fit.noise)
    return refine(problem, begun, hold(fit, nuisance), 4)
