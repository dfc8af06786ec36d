"""Whether effects act throughout, or from a time on, during a stretch of one session, or in a regime."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from simgap.diagnosis.config import LEAST_SHARE, LEVEL, REQUIRED, REQUIRED_OF_REGIMES
from simgap.diagnosis.hypotheses.features import of_rows
from simgap.diagnosis.hypotheses.space import Hypothesis, behind
from simgap.diagnosis.hypotheses.support import ALWAYS, LASTING, Support, Window, for_heldout, in_words, opened
from simgap.diagnosis.inference.alternatives import Member
from simgap.diagnosis.inference.gauss_newton import hold, refine
from simgap.diagnosis.inference.heldout import gain
from simgap.diagnosis.inference.model import Model, Reporter, refitted_without, without
from simgap.diagnosis.inference.null_distribution import Evidence, Weighed, blocks, by_chance, weigh
from simgap.diagnosis.inference.scan import gain_of, narrowest, onset, scores, stretch
from simgap.diagnosis.inference.score_test import Screened, Screening, vary
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, trials
from simgap.diagnosis.likelihood.segments import Chunks, Rows, rows_of
from simgap.effects.regime import Regime, features

LATER = tuple(np.arange(0.0, 0.95, 0.15))
"""Shares of a session after which an effect may begin, where it is first looked for."""
PARTS = (0.35, 0.65)
"""Shares of the rows above and below which a regime may begin, where it is first looked for."""


class _Restriction(NamedTuple):
    """When a hypothesis may act, what that promises over the members as they are [nats], and the model it is in."""

    promise: float
    support: Support
    hypothesis: Hypothesis
    model: Model


def restriction(
    model: Model, members: tuple[Member, ...], supports: Sequence[Support], unseen: Chunks, report: Reporter
) -> Support | None:
    """When the first effect acts that fits better from a time on, during a stretch of one session, or in a regime.

    Of the effects that act throughout as yet; others have their `supports`, and what these gain may owe to misfit of
    their laws. None if none does. A regime is a law of the robot's, to which held-out sessions must agree.
    """
    problem, layout = model.problem, model.problem.augmented.layout
    throughout = tuple(m for m in members if m.hypothesis.support == ALWAYS)
    misfit = LEAST_SHARE * sum(m.gain for m in members if m.hypothesis.support != ALWAYS)
    for ways in _ways(model, throughout):
        # Those with shapes have an onset of their own.
        free = [(m, c) for m, c in ways if not any(constant.shapes for constant in c.effect.constants)]
        tried = [r for m, c in free for r in _restrictions(m, c, model.fit.loglik)]
        best = max(tried, key=lambda r: r.promise - required_gain(r.support), default=None)
        if best is None or best.promise <= required_gain(best.support) + misfit:
            continue
        restricted = _behind(with_support(best.model, supports, best.support), best.hypothesis, best.support)
        more = restricted.loglik - model.fit.loglik
        seen = for_heldout(layout, unseen, [*supports, best.support])
        if more > required_gain(best.support) + misfit and (
            not isinstance(best.support, Regime) or gain(problem, seen, model.fit, restricted) > 0
        ):
            report(f"{best.hypothesis.name} acts {in_words(layout, best.support)} ({more:+.1f} nats)")
            return best.support
    return None


def _ways(model: Model, members: tuple[Member, ...]) -> Iterator[list[tuple[Model, Hypothesis]]]:
    """What may be restricted: the first member alone, for the others may do no more than undo it where it does not act;
    then every member among the others, with its nearest rival, which it may beat for acting throughout only."""
    if len(members) > 1:
        first, *others = (m.hypothesis for m in members)
        yield [(refitted_without(model, others), first)]
    for m in members:
        ways = [(model, m.hypothesis)]
        if m.rival is not None:
            fit = evaluate(model.problem, m.rival.fit.v, m.rival.fit.groups)
            ways.append((model._replace(fit=fit), m.rival.hypothesis))
        yield ways


def _restrictions(model: Model, hypothesis: Hypothesis, loglik: float) -> list[_Restriction]:
    """From a time on, during a stretch, in a regime: a hypothesis fitted as if it acted throughout."""
    problem, fit, _ = model
    rows, found = rows_of(problem.chunks), _apart(problem, hypothesis)
    score, power = scores(fit, evaluate(problem, without(fit, hypothesis.groups).v, (), fit.noise).e, fit.e)
    from_on, a = onset(rows, score, power)
    during, b = stretch(rows, score, power, LASTING)
    regime, c = narrowest(found, score, power, LEAST_SHARE)
    throughout, ahead = float(gain_of(score.sum(), power.sum())), fit.loglik - loglik
    supports = ((from_on, a), (during, b - throughout), (regime, c))
    return [_Restriction(ahead + more, support, hypothesis, model) for support, more in supports]


class _Look(NamedTuple):
    """Rows in which effects are weighed anew: in a regime, or from a time on in one session or (None) in every."""

    rows: Bool[np.ndarray, " n"]
    session: int | None = None
    regime: bool = False


def hidden_restriction(
    model: Model, screening: Screening, rng: np.random.Generator, report: Reporter
) -> Support | None:
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
    report(f"the same from a time on, or in a regime: p = {p_value:.4f}")
    statistic, of_regimes = weighed.statistic.reshape(len(looks), -1), np.array([look.regime for look in looks])
    tried = []
    for kind in (of_regimes, ~of_regimes):  # what acts from a time on shows in some regimes, and the other way round
        among = np.where(kind[:, None], statistic, 0.0)
        if among.max() >= threshold:
            which, best = divmod(int(among.argmax()), len(score))
            tried.append(_begun(model, screening.found[best], looks[which]))
    best = max(tried, key=lambda r: r.promise - required_gain(r.support), default=None)
    if best is None or best.promise <= required_gain(best.support):
        return None
    report(f"{best.hypothesis.name} acts {in_words(problem.augmented.layout, best.support)} ({best.promise:+.1f} nats)")
    return best.support


def _begun(model: Model, screened: Screened, look: _Look) -> _Restriction:
    """When a hypothesis acts that shows in a look: it promises what it gains there, if the restriction is worth it."""
    problem, fit, nuisance = model
    evidence = scores(fit, fit.e, trials(problem, [vary(fit.v, screened.hypothesis, screened.start)])[0])
    if look.regime:
        support, more = narrowest(_apart(problem, screened.hypothesis), *evidence, LEAST_SHARE)
    else:
        rows = rows_of(problem.chunks)
        support, more = onset(rows, *evidence, look.session)
        if isinstance(support, Window):  # to its end
            last = rows.time_s[rows.session == support.session].max()
            support = replace(support, to_s=float(last) + problem.scales.time_step)
    if more <= required_gain(support):
        return _Restriction(0.0, support, screened.hypothesis, model)
    there, hypothesis = with_support(model, [], support), behind(screened.hypothesis, support, 1)
    begun = evaluate(
        there.problem, vary(there.fit.v, hypothesis, screened.start), (*fit.groups, *hypothesis.groups), fit.noise
    )
    return _Restriction(
        refine(there.problem, begun, hold(fit, nuisance), 4).loglik - fit.loglik, support, hypothesis, model
    )


def required_gain(support: Support) -> float:
    """Least gain [nats] of a restriction to a support."""
    return REQUIRED_OF_REGIMES if isinstance(support, Regime) else REQUIRED


def _apart(problem: Problem, hypothesis: Hypothesis) -> Float[np.ndarray, "n f"]:
    """The features of every row, those of the commands that the effect acts on made one value: an effect that differs
    with its own command is no other regime but another law."""
    layout = problem.augmented.layout
    own = [c for c in (f.name for f in layout.schema.command) if c in (*hypothesis.channels, *hypothesis.where.split())]
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


def with_support(model: Model, supports: Sequence[Support], support: Support) -> Model:
    """The model with one more support than it has, in which nothing acts yet."""
    problem, fit, nuisance = model
    supports = [*supports, support]
    chunks = opened(problem.augmented.layout, problem.chunks, supports)
    delta = np.zeros((len(supports), fit.v.delta.shape[1]), np.float32)
    delta[: len(supports) - 1] = fit.v.delta[: len(supports) - 1]
    return Model(problem._replace(chunks=chunks), fit._replace(v=fit.v._replace(delta=delta)), nuisance)


def _behind(model: Model, throughout: Hypothesis, support: Support) -> Fit:
    """The fit with an effect's constants moved behind the last support."""
    problem, fit, nuisance = model
    hypothesis = behind(throughout, support, len(fit.v.delta))
    constants = [float(fit.v.theta[g.entries[0]]) for g in throughout.groups]
    rest = without(fit, throughout.groups)
    begun = evaluate(problem, vary(rest.v, hypothesis, constants), (*rest.groups, *hypothesis.groups), fit.noise)
    return refine(problem, begun, hold(fit, nuisance), 4)
