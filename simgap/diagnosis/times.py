"""Whether effects act throughout: from a time on, during a stretch of one session, or as a push from outside."""

from collections.abc import Sequence

import numpy as np

from simgap.diagnosis.candidates import Candidate, gated
from simgap.diagnosis.fit import Fit, evaluate, optimise, refine, trials
from simgap.diagnosis.rivals import Member
from simgap.diagnosis.screen import vary
from simgap.diagnosis.search import LEAST_SHARE, LEVEL, Model, Say, without
from simgap.diagnosis.when import (
    LASTING,
    PUSH,
    When,
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
EXCEPTION = 3.0
"""Times the gain of the best other stretch that a push must gain."""


def acts_when(model: Model, members: tuple[Member, ...], say: Say) -> When | None:
    """When the first effect acts that fits better from a time on, or during a stretch of one session; None if none."""
    problem, fit, _ = model
    rows = rows_of(problem.chunks)
    for member in members:
        if any(c.shapes for c in member.candidate.effect.constants):
            continue  # it has an onset of its own
        score, power = scores(fit, evaluate(problem, without(fit, member.candidate.groups).v, (), fit.noise).e, fit.e)
        throughout = 0.5 * score.sum() ** 2 / max(power.sum(), 1e-9)
        from_on, a = onset(rows, score, power)
        during, b = stretch(rows, score, power, LASTING)
        when, more = max(((from_on, a), (during, b - throughout)), key=lambda w: w[1])
        if more > OWED:
            more = _behind_gate(_open(model, when), member.candidate).loglik - fit.loglik
            if more > OWED:
                say(f"{member.candidate.name} acts from {when.from_s:.1f} s on ({more:+.1f} nats)")
                return when
    return None


def pushed(
    model: Model, members: tuple[Member, ...], events: Sequence[Candidate], rng: np.random.Generator, say: Say
) -> tuple[Model, tuple[Member, ...]]:
    """A push during a stretch of one session, if one is more than the best of all stretches by chance."""
    problem, fit, _ = model
    rows = rows_of(problem.chunks)
    tried: list[tuple[float, Candidate, When, np.ndarray, np.ndarray]] = []
    for event in events:
        with_it = trials(problem, [vary(fit.v, event, event.starts[0])])[0]
        score, power = scores(fit, fit.e, with_it)
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
    at, candidate = _open(model, when).problem, gated(event)
    begun = evaluate(at, vary(fit.v, candidate, [0.0]), (*fit.groups, *candidate.groups), fit.noise)
    after = Model(at, *optimise(at, begun))
    more = after.fit.loglik - fit.loglik
    say(f"{event.name} from {when.from_s:.1f} to {when.to_s:.1f} s of one session ({more:+.1f} nats)")
    return after, (*members, Member(candidate, more, {event.effect.id: 1.0}, None, fit, when))


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
    return refine(problem, begun, nuisance, 4)
