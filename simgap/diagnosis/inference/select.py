"""Which effects explain the recordings: one more at a time, while noise cannot explain what the best of them gains."""

from collections.abc import Sequence

import numpy as np

from simgap.diagnosis.config import LEVEL, MOST_EFFECTS, MOST_SITES
from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.inference.gauss_newton import HELD, Held, hold, optimise, refine
from simgap.diagnosis.inference.model import (
    SETTLED,
    Found,
    HeldOutCheck,
    Model,
    Reporter,
    Round,
    Trial,
    absorbing,
    decorrelated,
    least,
    settled,
)
from simgap.diagnosis.inference.relaxation import room
from simgap.diagnosis.inference.relinearise import carried_on, fitted, relinearised, standing
from simgap.diagnosis.inference.score_test import Screened, screen, vary
from simgap.diagnosis.likelihood.filter import Variables
from simgap.diagnosis.likelihood.problem import THREADS, Fit, Problem, evaluate, side_by_side, trials, value_of
from simgap.diagnosis.likelihood.student_t import log_density

FITTED = 10
"""Hypotheses that get a first fit in a round, at most,"""
HOPELESS = 0.1
"""where they are expected to gain this share of the best gain so far."""
FINALISTS = 4
"""Those whose fit is carried on,"""
CONTENDER = 0.5
"""and to its end where it gains, or should, this share of what the best gains."""
SHARES = tuple(np.geomspace(1, 0.02, 8))
"""Of the amplitude that the screening expects, where a fit may start."""


def one_more(
    model: Model,
    hypotheses: Sequence[Hypothesis],
    rng: np.random.Generator,
    report: Reporter,
    found: Sequence[Hypothesis] = (),
    own: Trial | None = None,
) -> Round:
    """Screen all hypotheses, fit the most promising, carry the best of those to the end.

    found: the effects that the model has, around whose laws there is room for misfit. One of the hypotheses may be
    fitted already: the `own` that holds the place.
    """
    problem, fit, _ = model
    taken = {(entry, group.support) for group in fit.groups for entry in group.entries}
    free = [c for c in hypotheses if not taken & {(e, g.support) for g in c.groups for e in g.entries}]
    absorbed = absorbing(model)
    around = room(model, absorbed, found)
    screening = screen(problem, fit, around.whole, free, rng)
    report(f"{len(free)} hypotheses tested: p = {screening.p_value:.4f}")
    fitted = [around.judged(own)] if own else []
    if screening.p_value > LEVEL:
        return Round(screening, fitted)
    held = hold(fit, absorbed)
    likely = [s for s in promising(screening.found) if s.hypothesis.name not in {t.hypothesis.name for t in fitted}]
    tried: list[Trial] = []
    for some in _at_once(likely):
        best = max([t.gain for t in (*fitted, *tried)], default=0.0)
        some = [s for s in some if s.gain >= HOPELESS * best]
        begun = side_by_side(lambda s: _try(problem, fit, held, s, 3), some)
        tried += [t for t in begun if np.isfinite(t.gain)]
    tried.sort(key=lambda t: -t.promise)
    finalists = side_by_side(lambda t: t.further(lambda f: refine(problem, f, held, HELD)), tried[:FINALISTS])
    others, tried = tried[FINALISTS:], []
    for some in _at_once(sorted(finalists, key=lambda t: -t.promise)):
        best = max(t.gain for t in (*fitted, *finalists, *tried))
        tried += side_by_side(lambda t, best=best: _to_its_end(problem, t) if _contends(t, best) else t, some)
    tried = sorted([*fitted, *(around.judged(t) for t in (*tried, *others))], key=lambda t: -t.gain)
    report("tried " + ", ".join(f"{t.hypothesis.name} {t.gain:+.1f}" for t in tried[:4]) + " nats")
    return Round(screening, tried)


def _at_once(ordered: Sequence) -> list[Sequence]:
    return [ordered[first : first + THREADS] for first in range(0, len(ordered), THREADS)]


def _contends(t: Trial, best: float) -> bool:
    """Whether a hypothesis may gain as much as the best; one with basins may stand in a low one as yet."""
    return t.promise >= (HOPELESS if t.hypothesis.effect.basins else CONTENDER) * best


def _to_its_end(problem: Problem, t: Trial) -> Trial:
    """Fitted until steps gain next to nothing; where there are basins, from every start beyond where it stands too.

    From these with derivatives at the start itself: those at hand do not lead from there, nor do parameters as fitted
    in another basin.
    """
    ends = [t.further(lambda f: optimise(problem, f, settled(t.gain))[0])]
    if t.hypothesis.effect.basins:
        group = t.hypothesis.groups[0]
        now = value_of(t.fit.v, group)
        for start in (s for s in t.hypothesis.starts if s[0] > now):
            begun = evaluate(problem, vary(t.without.v, t.hypothesis, start), t.fit.groups, t.without.noise)
            if np.isfinite(begun.loglik):
                ends.append(t.further(lambda _, begun=begun: optimise(problem, begun, settled(t.gain))[0]))
    return max(ends, key=lambda end: end.gain)


def promising(found: Sequence[Screened]) -> list[Screened]:
    """The best two hypotheses of each effect, best first, each where it stands best.

    A limit's best direction may be that of one far too tight, which is nil, and leads nowhere, at any share of itself.
    """
    chosen: list[Screened] = []
    seen: set[tuple[str, bool, str]] = set()
    for s in found:
        key = (s.hypothesis.effect.key, bool(s.hypothesis.twin))
        name = (*key, s.hypothesis.where)
        if s.gain < 2 or name in seen:
            continue
        if sum((c.hypothesis.effect.key, bool(c.hypothesis.twin)) == key for c in chosen) < 2:
            near = [o for o in found if o.hypothesis is s.hypothesis and o.constant == s.constant]
            near = [o for o in near if o.gain >= CONTENDER * s.gain]
            chosen.append(s._replace(start=max(near, key=lambda o: o.as_it_stands).start))
            seen.add(name)
        if len(chosen) == FITTED:
            break
    return chosen


def _try(problem: Problem, fit: Fit, held: Held, s: Screened, iterations: int) -> Trial:
    v = _highest(problem, fit, s)
    twin = tuple(g for g in s.hypothesis.twin if g not in fit.groups)
    begun = evaluate(problem, v, (*fit.groups, *twin, *s.hypothesis.groups), fit.noise)
    done, rest = refine(problem, begun, held, iterations), fit
    if twin:
        there = vary(fit.v, s.hypothesis._replace(groups=s.hypothesis.twin), s.start)
        begun = evaluate(problem, there, (*fit.groups, *twin), fit.noise)
        rest = max(fit, refine(problem, begun, held, iterations + HELD), key=lambda f: f.loglik)
    return Trial.of(s.hypothesis, done, rest, s.gain)


def _highest(problem: Problem, fit: Fit, s: Screened) -> Variables:
    """The likeliest of several constants: near the start where derivatives lead nowhere, else between nil and there,
    for what the screening expects of an amplitude may lie beyond the summit."""
    constants = s.hypothesis.effect.constants
    if s.hypothesis.effect.jagged:
        near = [tuple(c * share for c in s.start) for share in np.linspace(0.9, 1.1, 36)]
    else:
        near = [
            tuple(c if of.shapes else c * share for of, c in zip(constants, s.start, strict=True)) for share in SHARES
        ]
    vs = [vary(fit.v, s.hypothesis, constants) for constants in near]
    logliks = [log_density(one, fit.noise).sum() for one in trials(problem, vs)]
    return vs[int(np.argmax(np.nan_to_num(logliks, nan=-np.inf)))]


def search(
    problem: Problem,
    fit: Fit,
    hypotheses: Sequence[Hypothesis],
    holds_out: HeldOutCheck,
    rng: np.random.Generator,
    report: Reporter,
) -> Found:
    """Add effects one by one, each the best of those that are more than noise and that held-out sessions agree to.

    An engine is searched with its parameters held first: fitted far, where an effect is missing, they hide it. Every
    gain is over parameters that are fitted.
    """
    held = standing(problem)
    model = decorrelated(held, optimise(held, fit)[0])
    there, rest = relinearised(model.problem, model.fit)
    base, chosen, rounds, refitted = rest, [], [], rest.loglik - model.fit.loglik < SETTLED
    while len({c.effect.id for c in chosen}) < MOST_EFFECTS and len(chosen) < MOST_SITES:
        found = one_more(model, hypotheses, rng, report, chosen)
        required = found.screening.threshold / 2
        worthy = [t for t in found.tried if t.beyond > max(required, least(model.problem, base, model.fit, t.fit))]
        best = None
        for t in worthy:
            retabulated, best = carried_on(model.problem, t, rest)
            gains = best is t or best.beyond > max(required, least(retabulated, base, rest, best.fit))
            if gains and holds_out(retabulated, best, required):
                model = decorrelated(retabulated, best.fit)
                break
            report(f"{t.hypothesis.name} does not hold on sessions that took no part" if gains else
                f"{t.hypothesis.name} gains too little over fitted parameters")  # fmt: skip
            best = None
        refitted, again = True, not refitted
        if best is None and again:
            model = fitted(there, rest)
            continue
        if best is None:
            rounds.append(found)
            break
        # Rivals are compared with what was chosen, the best that holds.
        tried = [best, *(t for t in found.tried if t.hypothesis is not best.hypothesis)]
        rounds.append(found._replace(tried=tried, accepted=best.hypothesis.name))
        chosen.append(best.hypothesis)
        report(f"added {best.hypothesis.name} ({best.gain:+.1f} nats)")
        rest = model.fit
    return Found(base, model, chosen, rounds)
