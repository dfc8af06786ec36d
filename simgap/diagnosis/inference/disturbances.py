"""Whether something pushed the robot from outside, during a stretch of one session."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import LEAST_SHARE, LEVEL, REQUIRED
from simgap.diagnosis.hypotheses.space import Hypothesis, behind, within_session
from simgap.diagnosis.hypotheses.support import ALWAYS, PUSH, Window, at_start, elsewhere, to_its_end, within
from simgap.diagnosis.inference.alternatives import Member, member
from simgap.diagnosis.inference.gauss_newton import optimise
from simgap.diagnosis.inference.model import Model, Reporter, Trial
from simgap.diagnosis.inference.onsets import with_support
from simgap.diagnosis.inference.scan import scores, stretch, stretch_by_chance
from simgap.diagnosis.inference.score_test import vary
from simgap.diagnosis.inference.select import one_more
from simgap.diagnosis.likelihood.problem import evaluate, trials
from simgap.diagnosis.likelihood.segments import Rows, rows_of

CLEARLY = 1.1
"""Times the gain of a push that something else must gain which acts as long."""
EXCEPTION = 3.0
"""Times the gain of the best other stretch that a push must gain."""


class _Push(NamedTuple):
    """An event and its best stretch: what it may gain there [nats], and with which constants."""

    event: Hypothesis
    constants: tuple[float, ...]
    window: Window
    gain: float
    score: Float[np.ndarray, " n"]
    power: Float[np.ndarray, " n"]


def pushed(
    model: Model,
    members: tuple[Member, ...],
    events: Sequence[Hypothesis],
    throughout: Sequence[Hypothesis],
    rng: np.random.Generator,
    report: Reporter,
) -> tuple[Model, tuple[Member, ...]]:
    """A push during a stretch of one session, if one is more than the best of all stretches by chance.

    Or what else explains that stretch, where it does so clearly better.
    """
    problem, fit, _ = model
    rows = rows_of(problem.chunks)
    tried = [_push(model, rows, event, start) for event in events for start in event.starts]
    if not tried or any(m.hypothesis.support != ALWAYS for m in members):
        return model, members
    best = max(tried, key=lambda p: p.gain)
    chance = stretch_by_chance(rows, best.score, best.power, LEVEL / len(tried), rng)
    if best.gain < chance + LEAST_SHARE * sum(m.gain for m in members):
        return model, members
    # A push is an exception: what recurs is something else.
    again = max(stretch(rows, elsewhere(rows, best.window, p.score), p.power, PUSH)[1] for p in tried)
    if best.gain < EXCEPTION * again:
        return model, members
    window = best.window
    drifts, pushes = within_session(throughout, events, to_its_end(rows, window))
    alike = (c for c in (*pushes, *drifts) if c.effect.law is best.event.effect.law and c.sites == best.event.sites)
    named = next(alike)
    there, hypothesis = with_support(model, [], window), behind(named, window, 1)
    begun = evaluate(
        there.problem, vary(there.fit.v, hypothesis, best.constants), (*fit.groups, *hypothesis.groups), fit.noise
    )
    after = Model(there.problem, *optimise(there.problem, begun))
    push = Trial.of(hypothesis, after.fit, fit)
    report(f"{named.name} from {window.from_s:.1f} to {window.to_s:.1f} s of one session ({push.gain:+.1f} nats)")
    others = [behind(c, window, 1) for c in drifts if c is not named]
    found = [push, *one_more(there, others, rng, report).tried]
    if len(found) > 1 and found[1].gain > CLEARLY * push.gain + REQUIRED:
        report(f"{found[1].hypothesis.name} explains that stretch better ({found[1].gain - push.gain:+.1f} nats)")
        found[:2] = found[1], push
        after = Model(there.problem, *optimise(there.problem, found[0].fit))
    return after, (*members, member(there.problem, found, fit))


def _push(model: Model, rows: Rows, event: Hypothesis, start: tuple[float, ...]) -> _Push:
    """The stretch that an event's start explains best."""
    problem, fit, _ = model
    score, power = scores(fit, fit.e, trials(problem, [vary(fit.v, event, start)])[0])
    window, gain = stretch(rows, score, power, PUSH)
    while gain > 0 and at_start(rows, window):
        # What a robot remembers of the time before its session looks like a push, and is not known.
        score = elsewhere(rows, window, score)
        window, gain = stretch(rows, score, power, PUSH)
    acts = within(rows, window)
    amplitude = score[acts].sum() / max(power[acts].sum(), 1e-9)
    constants = [c if of.shapes else amplitude * c for of, c in zip(event.effect.constants, start, strict=True)]
    low, _ = problem.augmented.bounds
    possible = all(c >= low[g.entries[0]] for c, g in zip(constants, event.groups, strict=True))
    return _Push(event, tuple(map(float, constants)), window, gain if possible else 0.0, score, power)
