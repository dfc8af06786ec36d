"""Compare every accepted effect with its alternatives, and compute their posterior probabilities."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from simgap.diagnosis.config import LEAST_SHARE
from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.inference.evidence.null_distribution import blocks
from simgap.diagnosis.inference.evidence.screening import Screening
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
    least,
    refitted_without,
    settled,
)
from simgap.diagnosis.inference.search.one_more import one_more
from simgap.diagnosis.inference.search.posterior import means_another
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate
from simgap.diagnosis.likelihood.student_t import log_density


class Member(NamedTuple):
    """An accepted effect.

    gain: of all accepted effects over those without it [nats]. odds: probability of every effect id that could take its
    place. rivals: the best fitted hypothesis of every other id, the best first. without: the fitted model that lacks
    the effect. misfit: further gain [nats] if its law could bend (see `relaxation.misfits`).
    """

    hypothesis: Hypothesis
    gain: float
    odds: dict[str, float]
    rivals: tuple[Trial, ...]
    without: Fit
    misfit: float = 0.0


def defend(
    found: Found, hypotheses: Sequence[Hypothesis], holds_out: HeldOutCheck, rng: np.random.Generator, report: Reporter
) -> tuple[Model, tuple[Member, ...], list[Round]]:
    """Compare every effect with its alternatives, given the others. Replace it by a better one; drop it if not needed.

    A replacement must hold on held-out sessions, as in `search`.
    """
    model, base = found.model, found.base
    if len(found.chosen) == 1:
        # The whitening has changed since `base` was fitted, so `base` is evaluated with the current one.
        rest = evaluate(model.problem, base.v, base.groups)
        return model, (member(model.problem, found.rounds[0].tried, rest),), []
    members, rounds = [], []
    for hypothesis, chosen in zip(found.chosen, found.rounds, strict=False):
        report(f"comparing {hypothesis.name} with its alternatives, given the other effects")
        problem, fit, _ = model
        reduced = refitted_without(model, [hypothesis], settled(chosen.tried[0].gain))
        own = Trial.of(hypothesis, fit, reduced.fit)
        others = [c for c in found.chosen if c is not hypothesis]
        tried = one_more(reduced, _rivals(hypothesis, chosen.screening, hypotheses), rng, report, others, own)
        rounds.append(tried)
        own = next(t for t in tried.tried if t.hypothesis is hypothesis)
        rivals = [t for t in tried.tried if t is not own]
        required = chosen.screening.threshold / 2
        # Fitted together with others, it may have become another law, which then has no lead to make up for.
        held = own._replace(gain=0.0) if means_another(problem, own.fit, own.hypothesis) else own
        better = _better(reduced, rivals, held, holds_out, required)
        if better is not None:
            report(f"{better.hypothesis.name} replaces {hypothesis.name} ({better.gain - own.gain:+.1f} nats)")
            model = Model(problem, *optimise(problem, better.fit))
            rivals.remove(better)
            own = better
        if own.beyond < max(required, least(problem, base, reduced.fit, model.fit)):
            report(f"{hypothesis.name} dropped: it is not needed given the other effects")
            model = reduced
        else:
            members.append(member(problem, [own, *rivals], reduced.fit))
    return model, tuple(members), rounds


def _rivals(hypothesis: Hypothesis, screening: Screening, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The hypothesis, and those whose expected gain was at least `LEAST_SHARE` of its own when it was chosen."""
    gains: dict[str, float] = {}
    for s in screening.found:
        gains[s.hypothesis.name] = max(s.gain, gains.get(s.hypothesis.name, 0.0))
    least = LEAST_SHARE * gains.get(hypothesis.name, 0.0)
    near = {name for name, gain in gains.items() if gain >= least and name != hypothesis.name}
    return [c for c in hypotheses if c is hypothesis or c.name in near]


def _better(
    reduced: Model, rivals: Sequence[Trial], own: Trial, holds_out: HeldOutCheck, required: float
) -> Trial | None:
    """The best rival of another id with over 1 nat more evidence than `own`, if it holds on held-out sessions.

    It must have more than `own` at any other site too: if that has most, the effect is right and may act at both.
    """
    effect = own.hypothesis.effect.id
    most = max([own.evidence, *(t.evidence for t in rivals if t.hypothesis.effect.id == effect)])
    ahead = (t for t in rivals if t.evidence > most + SETTLED and t.hypothesis.effect.id != effect)
    return next((t for t in ahead if holds_out(reduced.problem, t, required)), None)


def drop_dominated(
    model: Model, members: tuple[Member, ...], gain: float, report: Reporter
) -> tuple[Model, tuple[Member, ...]]:
    """Drop members that gain less than `LEAST_SHARE` of `gain`, that of outlier rows: these may produce such gains."""
    dropped = [m for m in members if m.gain < LEAST_SHARE * gain]
    for m in dropped:
        report(f"{m.hypothesis.name} dropped: its gain is small next to that of outlier rows")
        model = refitted_without(model, [m.hypothesis])
    return model, tuple(m for m in members if m not in dropped)


def member(problem: Problem, tried: Sequence[Trial], rest: Fit) -> Member:
    """Member of the first hypothesis tried, the best; those of other ids are its rivals."""
    own, best = tried[0], _best_of_each(tried)
    rivals = sorted((t for t in best.values() if t is not best[own.hypothesis.effect.id]), key=lambda t: -t.evidence)
    return Member(own.hypothesis, own.gain, odds(problem, tried), tuple(rivals), rest)


def odds(problem: Problem, tried: Sequence[Trial]) -> dict[str, float]:
    """Posterior probability of each effect id, by its best hypothesis. `tried` begins with the best of all."""
    starts, best = blocks(np.asarray(problem.chunks.counts)), _best_of_each(tried)
    rows = {k: log_density(t.fit.e, t.fit.noise).sum(1) for k, t in best.items()}
    lead, constants = tried[0].hypothesis.effect.id, {k: len(t.hypothesis.groups) for k, t in best.items()}
    return compared(rows, constants, starts, lead, best[lead].gain)


def _best_of_each(tried: Sequence[Trial]) -> dict[str, Trial]:
    """Of every effect id the hypothesis with most evidence."""
    best: dict[str, Trial] = {}
    for t in tried:
        current = best.get(t.hypothesis.effect.id)
        if current is None or t.evidence > current.evidence:
            best[t.hypothesis.effect.id] = t
    return best


def compared(
    density: Mapping[str, Float[np.ndarray, " n"]],
    constants: Mapping[str, int],
    starts: Int[np.ndarray, " B"],
    lead: str,
    gain: float,
) -> dict[str, float]:
    """Posterior probability of each name: log-likelihood of its rows minus log n / 2 per constant, relative to `lead`.

    gain: of the lead [nats]. A deficit counts only beyond `LEAST_SHARE` of that gain, because a smaller one may only
    reflect misfit of the laws. The ratio of two likelihoods is itself uncertain: where its variance over blocks of rows
    exceeds that of a correct model (twice the mean), the ratio is scaled down accordingly [Vuong 1989].
    """
    score = {k: float(d.sum()) - cost(constants[k], len(d)) for k, d in density.items()}
    logits = {}
    for k in density:
        deficit = max(score[lead] - score[k] - LEAST_SHARE * max(gain, 0.0), 0.0) if k != lead else 0.0
        difference = np.add.reduceat(density[lead] - density[k], starts)
        variance = len(difference) * float(np.var(difference))
        logits[k] = -deficit * min(1.0, 2 * deficit / variance) if variance > 0 else -deficit
    total = np.logaddexp.reduce(list(logits.values()))
    return {k: float(np.exp(v - total)) for k, v in sorted(logits.items(), key=lambda kv: -kv[1])}
