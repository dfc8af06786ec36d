"""Whether effects act throughout: from a time on, during a stretch of one session, or as a push from outside."""

from collections.abc import Sequence

import numpy as np

from simgap.diagnosis.candidates import Candidate, besides, gated
from simgap.diagnosis.fit import Fit, evaluate, hold, optimise, refine, trials
from simgap.diagnosis.rivals import Member, member
from simgap.diagnosis.screen import Evidence, Screening, Weighed, blocks, by_chance, vary, weigh
from simgap.diagnosis.search import LEAST_SHARE, LEVEL, Model, Say, Tried, one_more, without
from simgap.diagnosis.when import (
    LASTING,
    PUSH,
    When,
    at_start,
    elsewhere,
    gate,
    onset,
    rows_of,
    scores,
    stretch,
    stretch_by_chance,
)

OWED = 8.0
"""Gain [nats] that an effect's beginning and end owe: two numbers, the best of some hundreds tried."""
LATER = tuple(np.arange(0.0, 0.95, 0.15))
"""Shares of a session after which an effect may begin, where it is first looked for."""
CLEARLY = 1.1
"""Times the gain of a push that something else must gain which acts as long."""
EXCEPTION = 3.0
"""Times the gain of the best other stretch that a push must gain."""


def acts_when(model: Model, members: tuple[Member, ...], say: Say) -> When | None:
    """When the first effect acts that fits better from a time on, or during a stretch of one session; None if none."""
    problem, fit, _ = model
    rows = rows_of(problem.chunks)
    for m in members:
        if any(c.shapes for c in m.candidate.effect.constants):
            continue  # it has an onset of its own
        score, power = scores(fit, evaluate(problem, without(fit, m.candidate.groups).v, (), fit.noise).e, fit.e)
        throughout = 0.5 * score.sum() ** 2 / max(power.sum(), 1e-9)
        from_on, a = onset(rows, score, power)
        during, b = stretch(rows, score, power, LASTING)
        when, more = max(((from_on, a), (during, b - throughout)), key=lambda w: w[1])
        if more > OWED:
            more = _behind_gate(_open(model, when), m.candidate).loglik - fit.loglik
            if more > OWED:
                say(f"{m.candidate.name} acts from {when.from_s:.1f} s on ({more:+.1f} nats)")
                return when
    return None


def begins(model: Model, screening: Screening, rng: np.random.Generator, say: Say) -> When | None:
    """From when on an effect acts, in every session or in one, that is nothing over all of them; None if by chance.

    The screening's hypotheses are weighed anew over what comes after some times.
    """
    problem, fit, _ = model
    rows = rows_of(problem.chunks)
    score, power, two_sided = screening.evidence
    starts = blocks(np.asarray(problem.chunks.counts))
    places = [None, *np.unique(rows.session).tolist()]
    later = [(place, share) for place in places for share in LATER if share or place is not None]
    among = {place: np.full(len(rows.time_s), True) if place is None else rows.session == place for place in places}
    after = [among[place] & (rows.time_s >= share * rows.time_s[among[place]].max()) for place, share in later]
    # One by one: all rows for all of these times would be gigabytes.
    each = [weigh(Evidence(score * on, power * on, two_sided), starts) for on in after]
    weighed = Weighed(*(np.concatenate(fields) for fields in zip(*each, strict=True)))
    p_value, _ = by_chance(weighed, LEVEL, rng)
    say(f"the same from a time on: p = {p_value:.4f}")
    if p_value > LEVEL:
        return None
    which, best = divmod(int(weighed.statistic.argmax()), len(score))
    hypothesis, place = screening.found[best], later[which][0]
    there = trials(problem, [vary(fit.v, hypothesis.candidate, hypothesis.start)])[0]
    when, more = onset(rows, *scores(fit, fit.e, there), place)
    if place is not None:  # to its end
        when = when._replace(to_s=float(rows.time_s[among[place]].max()) + problem.scales.time_step)
    say(f"{hypothesis.candidate.name} acts from {when.from_s:.1f} s on ({more:+.1f} nats)")
    return when if more > OWED else None


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
    tried: list[tuple[float, Candidate, When, np.ndarray, np.ndarray]] = []
    for event in events:
        with_it = trials(problem, [vary(fit.v, event, event.starts[0])])[0]
        score, power = scores(fit, fit.e, with_it)
        when, gain = stretch(rows, score, power, PUSH)
        while gain > 0 and at_start(rows, when):
            # What a robot remembers of the time before its session looks like a push, and is not known.
            score = elsewhere(rows, when, score)
            when, gain = stretch(rows, score, power, PUSH)
        tried.append((gain, event, when, score, power))
    if not tried or any(m.when for m in members):
        return model, members
    gain, event, when, score, power = max(tried, key=lambda t: t[0])
    chance = stretch_by_chance(rows, score, power, LEVEL / len(events), rng)
    if gain < chance + LEAST_SHARE * sum(m.gain for m in members):
        return model, members
    # A push is an exception: what recurs is something else.
    again = max(stretch(rows, elsewhere(rows, when, score), power, PUSH)[1] for *_, score, power in tried)
    if gain < EXCEPTION * again:
        return model, members
    there, candidate = _open(model, when), gated(event)
    begun = evaluate(there.problem, vary(fit.v, candidate, [0.0]), (*fit.groups, *candidate.groups), fit.noise)
    after = Model(there.problem, *optimise(there.problem, begun))
    push = Tried.of(candidate, after.fit, fit)
    say(f"{event.name} from {when.from_s:.1f} to {when.to_s:.1f} s of one session ({push.gain:+.1f} nats)")
    others = [gated(c) for c in besides(throughout, events)]
    alike = [push, *one_more(there, others, rng, say).tried]
    if len(alike) > 1 and alike[1].gain > CLEARLY * push.gain + OWED:
        say(f"{alike[1].candidate.name} explains that stretch better ({alike[1].gain - push.gain:+.1f} nats)")
        alike[:2] = alike[1], push
        after = Model(there.problem, *optimise(there.problem, alike[0].fit))
    return after, (*members, member(there.problem, alike, fit)._replace(when=when))


def _open(model: Model, when: When) -> Model:
    chunks = model.problem.chunks
    return model._replace(problem=model.problem._replace(chunks=chunks._replace(gate=gate(chunks, when))))


def _behind_gate(model: Model, throughout: Candidate) -> Fit:
    """The fit with an effect's constants moved behind the gate."""
    problem, fit, nuisance = model
    candidate = gated(throughout)
    constants = [float(fit.v.theta[g.entries[0]]) for g in throughout.groups]
    rest = without(fit, throughout.groups)
    begun = evaluate(problem, vary(rest.v, candidate, constants), (*rest.groups, *candidate.groups), fit.noise)
    return refine(problem, begun, hold(fit, nuisance), 4)
