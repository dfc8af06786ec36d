"""Forward selection of effects: one more at a time, while the best gains more than noise can explain.

Which effect comes first decides which others seem to be needed. So where another one is nearly as likely, a second
search begins with that one, and the likelier end counts.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simgap.diagnosis.config import LEAST_SHARE, MOST_EFFECTS, MOST_SITES
from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.inference.fitting.folded import without_sign
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.fitting.model import (
    SETTLED,
    Found,
    HeldOutCheck,
    Model,
    Reporter,
    Round,
    Trial,
    cost,
    decorrelated,
    least,
)
from simgap.diagnosis.inference.fitting.relinearise import carried_on, for_all, relinearised, standing
from simgap.diagnosis.inference.fitting.starts import begun_anew
from simgap.diagnosis.inference.search.one_more import FINALISTS, one_more
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.engines import is_engine


class Inputs(NamedTuple):
    """The constant inputs of a search.

    opening: id of the effect with which an earlier search of these recordings began. If it is nearly as likely as the
    likeliest, it comes first, and no other beginning is tried.
    """

    hypotheses: Sequence[Hypothesis]
    holds_out: HeldOutCheck
    rng: np.random.Generator
    report: Reporter
    opening: str | None = None


class _Way(NamedTuple):
    """A search on its way. base: fit without effects; without: fit of the model so far, which later gains are over.

    released: the problem with the parameters free; refitted: whether they are, in the model.
    """

    base: Fit
    model: Model
    without: Fit
    released: Problem
    refitted: bool
    chosen: tuple[Hypothesis, ...] = ()
    rounds: tuple[Round, ...] = ()

    @property
    def found(self) -> Found:
        """Its result."""
        return Found(self.base, self.model, list(self.chosen), list(self.rounds))

    @property
    def evidence(self) -> float:
        """Of the model so far [nats]."""
        return self.model.density - cost(sum(len(h.groups) for h in self.chosen), len(self.without.e))


class _Step(NamedTuple):
    """What may be added to a search on its way: the hypotheses of a round that gain enough, the likeliest first."""

    way: _Way
    current: Round
    eligible: list[Trial]


def search(inputs: Inputs, problem: Problem, fit: Fit) -> Found:
    """Add effects one by one, each the best of those that exceed noise and hold on held-out sessions.

    An engine is first searched with its parameters held: fitted while an effect is missing, they go far and hide
    it. Every gain is over fitted parameters.
    """
    held_problem = standing(problem)
    model = decorrelated(held_problem, optimise(held_problem, fit)[0])
    released, without = relinearised(model.problem, model.fit)
    begun = _Way(without, model, without, released, without.loglik - model.fit.loglik < SETTLED)
    end, opening = _to_the_end(inputs, begun)
    as_before = opening is not None and end.chosen[0].effect.id == inputs.opening
    other = _other_opening(opening, end) if opening and not as_before else None
    instead = _added(inputs, other) if other else None
    if instead is None:
        return end.found
    second, _ = _to_the_end(inputs, instead)
    ahead = second.evidence - end.evidence
    inputs.report(f"a search that begins with {instead.chosen[0].name} ends with a model of {ahead:+.1f} nats")
    return second.found if ahead > SETTLED else end.found


def _to_the_end(inputs: Inputs, way: _Way) -> tuple[_Way, _Step | None]:
    """Add effects while there are some to add. Also returns the step that added the first one."""
    opening = None
    while len({c.effect.id for c in way.chosen}) < MOST_EFFECTS and len(way.chosen) < MOST_SITES:
        step = _next_step(inputs, way)
        after = _added(inputs, step)
        if after is None and way.refitted:
            return way._replace(rounds=(*way.rounds, step.current)), opening
        if after is None:
            model = decorrelated(for_all(way.released, way.without.v), way.without)
            way = way._replace(base=model.fit, model=model, without=model.fit, refitted=True)
        else:
            way, opening = after, opening or step
    return way, opening


def _next_step(inputs: Inputs, way: _Way) -> _Step:
    """Fit what may be added."""
    own = without_sign(way.model, inputs.hypotheses)
    current = one_more(way.model, inputs.hypotheses, inputs.rng, inputs.report, way.chosen, own)
    now, problem = way.model.fit, way.model.problem
    required = current.screening.threshold / 2
    eligible = [t for t in current.tried if t.beyond > max(required, least(problem, way.base, now, t.fit))]
    if is_engine(problem.augmented.simulator):
        eligible = eligible[:FINALISTS]  # each takes further tables
    if not way.chosen:
        known = next((t for t in _near(eligible) if t.hypothesis.effect.id == inputs.opening), None)
        eligible.sort(key=lambda t: t is not known)
    return _Step(way, current, eligible)


def _added(inputs: Inputs, step: _Step) -> _Way | None:
    """The search after the first eligible effect that holds, if one does."""
    way, current, eligible = step
    required = current.screening.threshold / 2
    for t in eligible:
        retabulated, best = carried_on(way.model.problem, t, way.without)
        if best is not t and best.beyond <= max(required, least(retabulated, way.base, way.without, best.fit)):
            inputs.report(f"{t.hypothesis.name} rejected: it gains too little over fitted parameters")
            continue
        if not inputs.holds_out(retabulated, best, required):
            inputs.report(f"{t.hypothesis.name} rejected: it does not hold on held-out sessions")
            continue
        inputs.report(f"added {best.hypothesis.name} ({best.gain:+.1f} nats)")
        model = decorrelated(*begun_anew(for_all(retabulated, best.fit.v), best.fit))
        # The accepted hypothesis comes first: its rivals are compared with it.
        tried = [best, *(t for t in current.tried if t.hypothesis is not best.hypothesis)]
        accepted = current._replace(tried=tried, accepted=best.hypothesis.name)
        return way._replace(model=model, without=model.fit, refitted=True,
            chosen=(*way.chosen, best.hypothesis), rounds=(*way.rounds, accepted))  # fmt: skip
    return None


def _near(ordered: Sequence[Trial]) -> list[Trial]:
    """Those that differ so little from the first one that the difference may only reflect misfit of the laws."""
    return [t for t in ordered if t.evidence >= ordered[0].evidence - LEAST_SHARE * ordered[0].gain]


def _other_opening(opening: _Step, end: _Way) -> _Step | None:
    """The step with the next near effect of another id alone, if several effects are needed."""
    begun = next(i for i, t in enumerate(opening.eligible) if t.hypothesis is end.chosen[0])
    others = [t for t in _near(opening.eligible[begun:]) if t.hypothesis.effect.id != end.chosen[0].effect.id]
    return opening._replace(eligible=others[:1]) if others and len(end.chosen) > 1 else None
