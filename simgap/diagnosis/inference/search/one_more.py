"""One round of a search: which hypotheses, added to a model, gain more than noise can explain."""

from collections.abc import Sequence

import numpy as np

from simgap.diagnosis.config import LEAST_SHARE, LEVEL, NEAR
from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.inference.evidence.null_distribution import short
from simgap.diagnosis.inference.evidence.score_test import screen, vary
from simgap.diagnosis.inference.evidence.screening import Screened
from simgap.diagnosis.inference.fitting.gauss_newton import HELD, Held, hold, refine
from simgap.diagnosis.inference.fitting.model import Model, Reporter, Round, Trial, absorbing
from simgap.diagnosis.inference.fitting.multistart import converged
from simgap.diagnosis.inference.misfit.relaxation import room
from simgap.diagnosis.inference.search.posterior import means_another
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, trials
from simgap.diagnosis.likelihood.student_t import log_density
from simgap.diagnosis.likelihood.variables import Variables
from simgap.threads import THREADS, side_by_side

FITTED = 10
"""Hypotheses that get a first fit in a round, at most."""
HOPELESS = 0.1
"""Share of the best gain so far that a hypothesis must be expected to gain to get a first fit."""
FINALISTS = 4
"""Hypotheses whose fit is continued, at most."""
CONTENDER = 0.5
"""Share of the best gain that a hypothesis must gain, or be expected to gain, to be fitted to convergence."""
SHARES = tuple(np.geomspace(1, 0.02, 8))
"""Shares of the amplitude that the screening expects at which a fit may start."""


def one_more(
    model: Model,
    hypotheses: Sequence[Hypothesis],
    rng: np.random.Generator,
    report: Reporter,
    found: Sequence[Hypothesis] = (),
    own: Trial | None = None,
) -> Round:
    """Screen all hypotheses, fit the most promising, and fit the best of those to convergence.

    found: the effects in the model; misfit of their laws is allowed for. own: a hypothesis that is fitted already,
    because it holds the place that the others compete for.
    """
    problem, fit, _ = model
    taken = {(entry, group.support) for group in fit.groups for entry in group.entries}
    free = [c for c in hypotheses if not taken & {(e, g.support) for g in c.groups for e in g.entries}]
    free = [c for c in free if not any(_of_one_kind(c, other) for other in found)]
    absorbed = absorbing(model)
    allowance = room(model, absorbed, found)
    screening = screen(problem, fit, allowance.whole, free, rng)
    report(f"{len(free)} hypotheses tested: p = {screening.p_value:.4f}")
    incumbent = [allowance.judged(own)] if own else []
    if screening.p_value > (NEAR if short(np.asarray(problem.chunks.counts)) else LEVEL):
        return Round(screening, incumbent, screening.p_value)
    held = hold(fit, absorbed)
    likely = [s for s in promising(screening.found) if s.hypothesis.name not in {t.hypothesis.name for t in incumbent}]
    tried: list[Trial] = []
    for batch in _at_once(likely):
        best = max([t.gain for t in (*incumbent, *tried)], default=0.0)
        batch = [s for s in batch if s.gain >= HOPELESS * best]
        first_fits = side_by_side(lambda s: _try(problem, fit, held, s, 3), batch)
        tried += [t for t in first_fits if np.isfinite(t.gain)]
    tried.sort(key=lambda t: -t.promise)
    finalists = side_by_side(lambda t: t.further(lambda f: refine(problem, f, held, HELD)), tried[:FINALISTS])
    others, tried = tried[FINALISTS:], []
    for batch in _at_once(sorted(finalists, key=lambda t: -t.promise)):
        best = max(t.gain for t in (*incumbent, *finalists, *tried))
        tried += converged(problem, [t for t in batch if _contends(t, best)])
        tried += [t for t in batch if not _contends(t, best)]
    judged = [allowance.judged(t) for t in (*tried, *others)]
    p_values = [screening.p_value_of_fit(t.hypothesis.name, t.beyond) for t in judged]
    if screening.p_value > LEVEL:  # then a fit has to pass by itself
        judged = [t for t, p_value in zip(judged, p_values, strict=True) if p_value <= LEVEL]
    judged = [t for t in judged if not means_another(problem, t.fit, t.hypothesis)]
    judged = [t for t in judged if not _extends_in_vain(t, [*incumbent, *judged])]
    tried = sorted([*incumbent, *judged], key=lambda t: -t.evidence)
    report("tried " + ", ".join(f"{t.hypothesis.name} {t.gain:+.1f}" for t in tried[:4]) + " nats" if tried else
        "fitted, they gain no more than noise alone")  # fmt: skip
    return Round(screening, tried, min([screening.p_value, *p_values]))


def _at_once(ordered: Sequence) -> list[Sequence]:
    """Batches of `THREADS`, in order."""
    return [ordered[first : first + THREADS] for first in range(0, len(ordered), THREADS)]


def _contends(t: Trial, best: float) -> bool:
    """Whether a hypothesis may gain as much as the best. One with basins needs less: it may still be in a poor one."""
    return t.promise >= (HOPELESS if t.hypothesis.effect.basins else CONTENDER) * best


def _of_one_kind(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether they are two laws of one kind of friction, at one place: together they would only mend their forms."""
    kinds = {c.effect.extends or c.effect.id for c in (one, other)}
    related = len(kinds) == 1 and (one.effect.extends or other.effect.extends)
    return bool(related) and one.effect is not other.effect and not {*one.outputs}.isdisjoint(other.outputs)


def _extends_in_vain(t: Trial, tried: Sequence[Trial]) -> bool:
    """Whether a simpler law, which this one extends, gains as much, but for what further constants gain by chance and
    what may only reflect misfit."""
    effect = t.hypothesis.effect
    simpler = [o for o in tried if o.hypothesis.effect.id == effect.extends and o.hypothesis.effect is not effect]
    return any(t.evidence - LEAST_SHARE * t.gain < o.evidence for o in simpler)


def promising(found: Sequence[Screened]) -> list[Screened]:
    """The best two hypotheses of each effect, best first, each at the start that gains most as it stands.

    The direction that gains most may be that of a limit that is far too tight, which no share of its constant has.
    """
    chosen: list[Screened] = []
    seen: set[tuple[str, bool, str]] = set()
    for s in found:
        key = (s.hypothesis.effect.key, bool(s.hypothesis.twin))
        name = (*key, s.hypothesis.where)
        if s.gain < 2 or name in seen:
            continue
        if sum((c.hypothesis.effect.key, bool(c.hypothesis.twin)) == key for c in chosen) < 2:
            starts = [o for o in found if o.hypothesis is s.hypothesis and o.constant == s.constant]
            starts = [o for o in starts if o.gain >= CONTENDER * s.gain]
            chosen.append(s._replace(start=max(starts, key=lambda o: o.as_it_stands).start))
            seen.add(name)
        if len(chosen) == FITTED:
            break
    return chosen


def _try(problem: Problem, fit: Fit, held: Held, s: Screened, iterations: int) -> Trial:
    """First fit of a screened hypothesis, and of the model without it: that has its twin, if there is one."""
    v = _highest(problem, fit, s)
    twin = tuple(g for g in s.hypothesis.twin if g not in fit.groups)
    initial = evaluate(problem, v, (*fit.groups, *twin, *s.hypothesis.groups), fit.noise)
    with_it, without = refine(problem, initial, held, iterations), fit
    if twin:
        with_twin = vary(fit.v, s.hypothesis._replace(groups=s.hypothesis.twin), s.start)
        initial = evaluate(problem, with_twin, (*fit.groups, *twin), fit.noise)
        without = max(fit, refine(problem, initial, held, iterations + HELD), key=lambda f: f.loglik)
    return Trial.of(s.hypothesis, with_it, without, s.gain)


def _highest(problem: Problem, fit: Fit, s: Screened) -> Variables:
    """The constants with the greatest likelihood among several.

    For jagged laws, whose derivatives lead nowhere, they lie near the start. For others they lie between zero and the
    start, because the amplitude that the screening expects may be beyond the maximum.
    """
    constants = s.hypothesis.effect.constants
    if s.hypothesis.effect.jagged:
        tried = [tuple(c * share for c in s.start) for share in np.linspace(0.9, 1.1, 36)]
    else:
        tried = [
            tuple(c if k.shapes else c * share for k, c in zip(constants, s.start, strict=True)) for share in SHARES
        ]
    vs = [vary(fit.v, s.hypothesis, constants) for constants in tried]
    logliks = [log_density(e, fit.noise).sum() for e in trials(problem, vs)]
    return vs[int(np.argmax(np.nan_to_num(logliks, nan=-np.inf)))]
