"""Detection of a push from outside: a disturbance during a window of one session."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import CLEARLY, EXCEPTION, LEAST_SHARE, LEVEL, REQUIRED, SHORTEST_PUSH
from simgap.diagnosis.hypotheses.space import Hypothesis, behind, within_session
from simgap.diagnosis.hypotheses.support import ALWAYS, Window, at_start, elsewhere, to_its_end, within
from simgap.diagnosis.inference.evidence.scan import scores, stretch, stretch_by_chance
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.fitting.model import Model, Reporter, Trial
from simgap.diagnosis.inference.search.alternatives import Member, member
from simgap.diagnosis.inference.search.one_more import one_more
from simgap.diagnosis.inference.search.onsets import with_support
from simgap.diagnosis.likelihood.problem import evaluate, trials
from simgap.diagnosis.likelihood.segments import Rows, rows_of


class _Push(NamedTuple):
    """A push hypothesis with its best window, the gain it may have there [nats], and the constants for it."""

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
    """Add a push during a window of one session, if it gains more than the best of all windows does by chance.

    If another law explains that window clearly better, add that one instead.
    """
    problem, fit, _ = model
    rows = rows_of(problem.chunks)
    candidates = [_push(model, rows, event, start) for event in events for start in event.starts]
    if not candidates or any(m.hypothesis.support != ALWAYS for m in members):
        return model, members
    best = max(candidates, key=lambda p: p.gain)
    threshold = stretch_by_chance(rows, best.score, best.power, LEVEL / len(candidates), rng)
    if best.gain < threshold + LEAST_SHARE * sum(m.gain for m in members):
        return model, members
    # A push is an exception: a cause that recurs in other windows is no push.
    next_gain = max(stretch(rows, elsewhere(rows, best.window, p.score), p.power, SHORTEST_PUSH)[1] for p in candidates)
    if best.gain < EXCEPTION * next_gain:
        return model, members
    window = best.window
    drifts, pushes = within_session(throughout, events, to_its_end(rows, window))
    same_law = (c for c in (*pushes, *drifts) if c.effect.law is best.event.effect.law and c.sites == best.event.sites)
    named = next(same_law)
    gated, hypothesis = with_support(model, [], window), behind(named, window, 1)
    initial = evaluate(
        gated.problem, vary(gated.fit.v, hypothesis, best.constants), (*fit.groups, *hypothesis.groups), fit.noise
    )
    after = Model(gated.problem, *optimise(gated.problem, initial))
    push = Trial.of(hypothesis, after.fit, fit)
    report(f"{named.name} from {window.from_s:.1f} to {window.to_s:.1f} s of one session ({push.gain:+.1f} nats)")
    alternatives = [behind(c, window, 1) for c in drifts if c is not named]
    ranked = [push, *one_more(gated, alternatives, rng, report).tried]
    if len(ranked) > 1 and ranked[1].gain > CLEARLY * push.gain + REQUIRED:
        report(f"{ranked[1].hypothesis.name} explains that window better ({ranked[1].gain - push.gain:+.1f} nats)")
        ranked[:2] = ranked[1], push
        after = Model(gated.problem, *optimise(gated.problem, ranked[0].fit))
    return after, (*members, member(gated.problem, ranked, fit))


def _push(model: Model, rows: Rows, event: Hypothesis, start: tuple[float, ...]) -> _Push:
    """The window that a push hypothesis explains best from a start."""
    problem, fit, _ = model
    score, power = scores(fit, fit.e, trials(problem, [vary(fit.v, event, start)])[0])
    window, gain = stretch(rows, score, power, SHORTEST_PUSH)
    while gain > 0 and at_start(rows, window):
        # Memory of the time before a session looks like a push and is not recorded: skip windows at its start.
        score = elsewhere(rows, window, score)
        window, gain = stretch(rows, score, power, SHORTEST_PUSH)
    inside = within(rows, window)
    amplitude = score[inside].sum() / max(power[inside].sum(), 1e-9)
    constants = [c if k.shapes else amplitude * c for k, c in zip(event.effect.constants, start, strict=True)]
    low, _ = problem.augmented.bounds
    within_bounds = all(c >= low[g.entries[0]] for c, g in zip(constants, event.groups, strict=True))
    return _Push(event, tuple(map(float, constants)), window, gain if within_bounds else 0.0, score, power)
