"""Restrictions: whether effects act throughout, from a time on, during a window of one session, or in a regime."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from simgap.diagnosis.config import EXPLAINED, LEAST_SHARE, LEVEL, REQUIRED, REQUIRED_OF_REGIMES, SHORTEST_WINDOW
from simgap.diagnosis.hypotheses.features import of_rows
from simgap.diagnosis.hypotheses.space import Hypothesis, behind
from simgap.diagnosis.hypotheses.support import ALWAYS, From, Support, Window, for_heldout, in_words, opened
from simgap.diagnosis.inference.evidence.null_distribution import Weighed, blocks, by_chance, weigh_each
from simgap.diagnosis.inference.evidence.scan import gain_of, narrowest, onset, scores, stretch
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.evidence.screening import Screened, Screening
from simgap.diagnosis.inference.fitting.gauss_newton import hold, refine
from simgap.diagnosis.inference.fitting.heldout import gain
from simgap.diagnosis.inference.fitting.model import Model, Reporter, Trial, refitted_without, without
from simgap.diagnosis.inference.search.alternatives import Member
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, trials
from simgap.diagnosis.likelihood.segments import Chunks, Rows, rows_of
from simgap.effects.regime import Regime, features

LATER = tuple(np.arange(0.0, 0.95, 0.15))
"""Shares of a session at which the coarse search tries onsets."""
PARTS = (0.35, 0.65)
"""Quantiles of a feature at which the coarse search tries edges of regimes."""


class _Restriction(NamedTuple):
    """A support for a hypothesis, its expected gain over the current members [nats], and the model it belongs to."""

    promise: float
    support: Support
    hypothesis: Hypothesis
    model: Model


def restriction(
    model: Model, members: tuple[Member, ...], supports: Sequence[Support], unseen: Chunks, report: Reporter
) -> Support | None:
    """The support of the first effect that fits better from a time on, during a window of one session, or in a regime.

    None if there is none. Only effects that still act throughout are tried. The others have their `supports`; a share
    of their gain may reflect misfit of their laws, so it is required in addition. A regime is a property of the robot,
    so held-out sessions must agree.
    """
    problem, layout = model.problem, model.problem.augmented.layout
    throughout = tuple(m for m in members if m.hypothesis.support == ALWAYS)
    misfit = LEAST_SHARE * sum(m.gain for m in members if m.hypothesis.support != ALWAYS)
    for candidates in _candidates(model, throughout):
        tried = [r for m, h in candidates if not _has_onset(h) for r in _restrictions(m, h, model.fit.loglik)]
        # A rival that is fitted as if it acted throughout has moved the parameters: it may gain more than promised.
        late = [(m, h, from_on(m, h, model.fit.loglik, supports)) for m, h in candidates[1:]]
        tried += [_Restriction(r.fit.loglik - model.fit.loglik, r.support, h, m) for m, h, r in late if r]
        best = max(tried, key=lambda r: r.promise - required_gain(r.support), default=None)
        if best is None or best.promise <= required_gain(best.support) + misfit:
            continue
        restricted = _moved_to_support(with_support(best.model, supports, best.support), best.hypothesis, best.support)
        extra = restricted.loglik - max(model.fit.loglik, best.model.fit.loglik)
        heldout = for_heldout(layout, unseen, [*supports, best.support])
        if extra > required_gain(best.support) + misfit and (
            not isinstance(best.support, Regime) or gain(problem, heldout, model.fit, restricted) > 0
        ):
            report(f"{best.hypothesis.name} acts {in_words(layout, best.support)} ({extra:+.1f} nats)")
            return best.support
    return None


class Late(NamedTuple):
    """A hypothesis fitted from its best time on."""

    support: From
    fit: Fit


def from_on(model: Model, hypothesis: Hypothesis, loglik: float, supports: Sequence[Support]) -> Late | None:
    """A hypothesis from its best time on, given a model in which it acts throughout, with these supports.

    None if it has an onset of its own, or its scores promise too little: less than half of what it lacks to `loglik`.
    """
    if _has_onset(hypothesis):
        return None
    support, extra = onset(rows_of(model.problem.chunks), *_scores(model, hypothesis))
    if not isinstance(support, From) or extra <= max(REQUIRED, EXPLAINED * (loglik - model.fit.loglik)):
        return None
    return Late(support, _moved_to_support(with_support(model, supports, support), hypothesis, support))


def as_throughout(model: Model, rival: Trial) -> Model:
    """The model with a rival, which acts throughout, in the place of the effect that it competes with."""
    return model._replace(fit=evaluate(model.problem, rival.fit.v, rival.fit.groups))


def _has_onset(hypothesis: Hypothesis) -> bool:
    """Whether an effect has an onset of its own: one with a shape constant has."""
    return any(constant.shapes for constant in hypothesis.effect.constants)


def _scores(model: Model, hypothesis: Hypothesis) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Score and information of every row for an effect of the model (see `scores`)."""
    problem, fit, _ = model
    return scores(fit, evaluate(problem, without(fit, hypothesis.groups).v, (), fit.noise).e, fit.e)


def _candidates(model: Model, members: tuple[Member, ...]) -> Iterator[list[tuple[Model, Hypothesis]]]:
    """Candidates for a restriction.

    First the first member alone, because the others may only undo it where it does not act. Then every member among the
    others, with its rivals, which it may beat only because all act throughout.
    """
    if len(members) > 1:
        first, *others = (m.hypothesis for m in members)
        yield [(refitted_without(model, others), first)]
    for m in members:
        yield [(model, m.hypothesis), *((as_throughout(model, t), t.hypothesis) for t in m.rivals)]


def _restrictions(model: Model, hypothesis: Hypothesis, loglik: float) -> list[_Restriction]:
    """The best onset, window and regime of a hypothesis, given its fit as if it acted throughout."""
    rows, values = rows_of(model.problem.chunks), _features_of_others(model.problem, hypothesis)
    score, power = _scores(model, hypothesis)
    later, a = onset(rows, score, power)
    during, b = stretch(rows, score, power, SHORTEST_WINDOW)
    regime, c = narrowest(values, score, power, LEAST_SHARE)
    # Where it acts throughout, a rival may fit better than the model: that is no reason for a restriction.
    throughout, ahead = float(gain_of(score.sum(), power.sum())), min(model.fit.loglik - loglik, 0.0)
    supports = ((later, a), (during, b - throughout), (regime, c))
    return [_Restriction(ahead + extra, support, hypothesis, model) for support, extra in supports]


class _Look(NamedTuple):
    """Rows over which effects are tested again: in a regime, or from a time on in one session or (None) in every."""

    rows: Bool[np.ndarray, " n"]
    session: int | None = None
    regime: bool = False


def hidden_restriction(
    model: Model, screening: Screening, gained: float, rng: np.random.Generator, report: Reporter
) -> Support | None:
    """The onset or regime of an effect that shows less, or not at all, over all rows; None if chance may explain it.

    Tests the hypotheses of the screening again, after several times, and above and below several edges. model: the one
    that was screened. gained: by effects found since [nats], which it must exceed.
    """
    problem = model.problem
    rows, values = rows_of(problem.chunks), of_rows(problem.augmented.layout, problem.chunks)
    starts = blocks(np.asarray(problem.chunks.counts))
    looks = [*_onset_looks(rows), *_regime_looks(values)]
    per_look = weigh_each(screening.evidence, starts, np.array([look.rows for look in looks], bool))
    weighed = Weighed(*(np.concatenate(fields) for fields in zip(*per_look, strict=True)))
    if weighed.statistic.max(initial=0.0) <= gained + REQUIRED:
        return None
    chance = by_chance(weighed, rng)
    p_value, threshold = chance.p_value(weighed.statistic.max(initial=0.0)), chance.critical(LEVEL)
    report(f"effects from a time on, or in a regime: p = {p_value:.4f}")
    statistic, of_regimes = weighed.statistic.reshape(len(looks), -1), np.array([look.regime for look in looks])
    tried = []
    for kind in (of_regimes, ~of_regimes):  # an onset also shows in some regimes, and a regime after some times
        of_kind = np.where(kind[:, None], statistic, 0.0)
        if of_kind.max() >= max(threshold, gained):
            which, best = divmod(int(of_kind.argmax()), len(screening.found))
            tried.append(_restriction_near(model, screening.found[best], looks[which]))
    best = max(tried, key=lambda r: r.promise - required_gain(r.support), default=None)
    if best is None or best.promise <= gained + required_gain(best.support):
        return None
    more = best.promise - gained
    report(f"{best.hypothesis.name} acts {in_words(problem.augmented.layout, best.support)} ({more:+.1f} nats)")
    return best.support


def _restriction_near(model: Model, screened: Screened, look: _Look) -> _Restriction:
    """A restriction of a hypothesis that shows in a look; its promise is 0 if the restriction gains too little."""
    problem, fit, nuisance = model
    evidence = scores(fit, fit.e, trials(problem, [vary(fit.v, screened.hypothesis, screened.start)])[0])
    if look.regime:
        support, extra = narrowest(_features_of_others(problem, screened.hypothesis), *evidence, LEAST_SHARE)
    else:
        rows = rows_of(problem.chunks)
        support, extra = onset(rows, *evidence, look.session)
        if isinstance(support, Window):  # ends with the session
            last = rows.time_s[rows.session == support.session].max()
            support = replace(support, to_s=float(last) + problem.scales.time_step)
    if extra <= required_gain(support):
        return _Restriction(0.0, support, screened.hypothesis, model)
    gated, hypothesis = with_support(model, [], support), behind(screened.hypothesis, support, 1)
    initial = evaluate(
        gated.problem, vary(gated.fit.v, hypothesis, screened.start), (*fit.groups, *hypothesis.groups), fit.noise
    )
    return _Restriction(
        refine(gated.problem, initial, hold(fit, nuisance), 4).loglik - fit.loglik, support, hypothesis, model
    )


def required_gain(support: Support) -> float:
    """Minimum gain [nats] of a restriction to a support."""
    return REQUIRED_OF_REGIMES if isinstance(support, Regime) else REQUIRED


def _features_of_others(problem: Problem, hypothesis: Hypothesis) -> Float[np.ndarray, "n f"]:
    """The features of every row, with those of the effect's own commands set to zero: an effect that varies with its
    own command is another law, not a regime."""
    layout = problem.augmented.layout
    own = [c for c in (f.name for f in layout.schema.command) if c in (*hypothesis.channels, *hypothesis.where.split())]
    is_own = np.array([f.name.strip("|") in own for f in features(layout)])
    return np.where(is_own, 0.0, of_rows(layout, problem.chunks))


def _onset_looks(rows: Rows) -> Iterator[_Look]:
    """Looks after several times, in all sessions together and in each."""
    for session in (None, *np.unique(rows.session).tolist()):
        in_session = np.full(len(rows.time_s), True) if session is None else rows.session == session
        for share in LATER:
            if share or session is not None:
                yield _Look(in_session & (rows.time_s >= share * rows.time_s[in_session].max()), session)


def _regime_looks(values: Float[np.ndarray, "n f"]) -> Iterator[_Look]:
    """Looks above and below several edges of every feature."""
    for column in values.T:
        for edge in np.quantile(column, PARTS):
            yield _Look(column > edge, regime=True)
            yield _Look(column <= edge, regime=True)


def with_support(model: Model, supports: Sequence[Support], support: Support) -> Model:
    """The model with one more support, in which no effect acts yet."""
    problem, fit, nuisance = model
    supports = [*supports, support]
    chunks = opened(problem.augmented.layout, problem.chunks, supports)
    delta = np.zeros((len(supports), fit.v.delta.shape[1]), np.float32)
    delta[: len(supports) - 1] = fit.v.delta[: len(supports) - 1]
    return Model(problem._replace(chunks=chunks), fit._replace(v=fit.v._replace(delta=delta)), nuisance)


def _moved_to_support(model: Model, throughout: Hypothesis, support: Support) -> Fit:
    """The fit with the constants of an effect moved to the last support."""
    problem, fit, nuisance = model
    hypothesis = behind(throughout, support, len(fit.v.delta))
    constants = [float(fit.v.theta[g.entries[0]]) for g in throughout.groups]
    bare = without(fit, throughout.groups)
    initial = evaluate(problem, vary(bare.v, hypothesis, constants), (*bare.groups, *hypothesis.groups), fit.noise)
    return refine(problem, initial, hold(fit, nuisance), 4)
