"""A diagnosis as it is reported: the statement that becomes diagnosis.json, and the numbers behind its pictures."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.hypotheses.support import Always, From, Since, Support, Window
from simgap.diagnosis.inference import posterior
from simgap.diagnosis.inference.alternatives import Member
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.heldout import gain
from simgap.diagnosis.inference.noise_effect import NoiseEffect
from simgap.diagnosis.inference.two_sample import whiteness_of
from simgap.diagnosis.inference.whiteness import Whiteness, whiteness
from simgap.diagnosis.likelihood.problem import evaluate, raw_innovations
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.diagnosis.report import figures, localisation, noise_figures, wording
from simgap.diagnosis.report.answers import (
    alternatives_of,
    beyond_of,
    credible_set,
    notes_of,
    parameters_of,
    rounds_of,
    sensitivity_of,
    untested_of,
)
from simgap.diagnosis.report.experiment import Experiment
from simgap.diagnosis.report.schema import NO_LIMITS, SCHEMA
from simgap.diagnosis.validation import black_box, scores
from simgap.diagnosis.validation.adequacy import Verdict
from simgap.diagnosis.validation.forecast import Contestant
from simgap.diagnosis.validation.scores import Judgement
from simgap.diagnosis.validation.sensitivity import Sensitivity
from simgap.effects.regime import Regime, features
from simgap.effects.regime import words as rule
from simgap.types import Recording, Sessions

SCATTERED = {"form": "scatter", "where": "all"}
"""Of every effect on the scatter."""
MISMATCH = ("missing_physics", "unexplained")
"""Verdicts with something to locate."""


class Plan(NamedTuple):
    """An experiment and the two effects that it tells apart."""

    experiment: Experiment
    separates: tuple[str, str]


class Outcome(NamedTuple):
    """What held-out sessions say of the contestants, what the recordings could have shown, what is found when
    parameters may leave their ranges (where some would), and what is concluded."""

    contestants: dict[str, Contestant]
    judged: Judgement
    seen: Sensitivity
    beyond: Explanation | None
    concluded: Verdict


def statement(
    name: str, found: Explanation, sessions: Sessions, outcome: Outcome, plan: Plan | None, rng: np.random.Generator
) -> dict[str, Any]:
    """All six answers in plain values, in the layout of diagnosis.json."""
    problem, concluded = found.problem, outcome.concluded
    verdict, share = concluded.verdict, concluded.share
    # Where no name stands, what is left over is what the simulator leaves by itself.
    whiteness = whiteness_of(problem, found.base, found.baseline) if verdict == "unexplained" else found.whiteness
    members = [(m, _effect(found, m, sessions.fitted)) for m in found.members]
    effects = [e for (_, e), sure in zip(members, concluded.named, strict=True) if sure]
    matches = [possible and not sure for possible, sure in zip(concluded.possible, concluded.named, strict=True)]
    doubtful = [e for (m, e), match in zip(members, matches, strict=True) if match and _matches(found, m, e)]
    noise_effects = [_scattered(s) for s in found.noise_effects]
    if verdict == "missing_physics":
        effects += noise_effects
    else:
        doubtful += [e for e in noise_effects if e["heldout_gain_nats"] > 0]
    content = {
        "schema": SCHEMA, "simulator": name, "verdict": verdict,
        "recordings": {
            "training_sessions": [r.name for r in sessions.training],
            "heldout_sessions": [r.name for r in sessions.heldout],
            "baseline": [r.name for r in sessions.baseline] or None,
            "transitions": int(np.asarray(problem.chunks.counts).sum()),
            "duration_s": float(sum(r.time_s[-1] - r.time_s[0] for r in (*sessions.fitted, *sessions.heldout))),
        },
        "located": _located(found, sessions, outcome, whiteness),
        "effects": effects, "more_missing": concluded.something_else,
        "closest_matches": doubtful, "whiteness": _whiteness(found, whiteness), "nonparametric": _law(found),
        "alternatives": alternatives_of(found),
        "experiment": plan and {"statement": wording.experiment(plan.experiment, plan.separates),
                                "commands": "experiment.csv", "separates": list(plan.separates)},
        "parameters": parameters_of(found) | {"moved": concluded.parameters_moved, "beyond": beyond_of(outcome.beyond)},
        "fit": {
            "heldout_sessions": [r.name for r in sessions.heldout], "least_rows": scores.LEAST_ROWS,
            "models": {model: scores.scores(problem.augmented.layout, j, rng)
                       for model, j in outcome.judged.heldout.items()},
            "explained_share": share and share["value"], "explained_share_ci95": share and share["ci95"],
            "black_box_better_at": list(concluded.beaten_at),
            "worse": [{"model": b, "than": a, "at": at} for (a, b), at in concluded.worse_at.items() if at],
        },
        "sensitivity": sensitivity_of(outcome.seen), "rounds": rounds_of(found), "untested": untested_of(found),
        "notes": notes_of(found, sessions),
    }  # fmt: skip
    content |= {"insufficient": wording.insufficient(content)}
    return {**content, "warnings": wording.warnings(content), "statement": wording.statement(content)}


def evidence(found: Explanation, sessions: Sessions, outcome: Outcome, plan: Plan | None) -> dict[str, Any]:
    """Arrays for the pictures."""
    problem = found.problem
    trained, held = (_excess(found, outcome, c) for c in (problem.chunks, found.unseen))
    longest = max(sessions.heldout, key=lambda r: len(r.time_s))
    return {
        "heat": localisation.heat(problem.augmented, trained),
        "strips": [
            *localisation.strips(trained, sessions.fitted, False),
            *localisation.strips(held, sessions.heldout, True),
        ],
        "laws": [p for m in found.members for p in figures.laws(problem, found.fit, m.hypothesis, trained)]
        + [SCATTERED | {"effect": s.id} | p for s in found.noise_effects for p in noise_figures.picture(s.shown)],
        "rollouts": figures.rollouts(problem, longest, outcome.contestants),
        "experiment": plan and figures.commands(problem, plan.experiment),
    }


def _matches(found: Explanation, member: Member, effect: dict[str, Any]) -> bool:
    """Whether an effect that is not named helps as a closest match: it holds on sessions that took no part, and the
    recordings determine its constants."""
    known = posterior.determined(found.problem, found.fit, member.hypothesis, found.sd, member.gain)
    return known and effect["heldout_gain_nats"] > 0


def _whiteness(found: Explanation, whiteness: Whiteness) -> dict[str, Any]:
    """What can still be predicted of the innovations, by output."""
    fields = found.problem.augmented.simulator.schema.outputs
    outputs = [{"name": f.name, "share": float(p)} for f, p in zip(fields, whiteness.share, strict=True) if p]
    return {"nats": float(whiteness.nats.sum()), "outputs": sorted(outputs, key=lambda o: -o["share"])}


def _law(found: Explanation) -> list[dict[str, Any]]:
    """What the law without a name depends on, term by term."""
    return [{"axis": t.axis, "depends_on": list(t.depends_on), "gain_nats": t.gain} for t in found.law.terms]


def _excess(found: Explanation, outcome: Outcome, chunks: Chunks) -> localisation.Excess:
    """What the best explanation gains over the refitted simulator: named physics, or else what names nothing.

    Of the latter, the best one: the black box, or the effects together with a law without a name, or with what can be
    predicted of what they leave.
    """
    problem = found.problem._replace(chunks=chunks)
    base, fitted = (raw_innovations(problem, f.v) for f in (found.base, found.fit))
    if outcome.concluded.verdict == "missing_physics":
        return localisation.excess(problem.augmented, chunks, base, fitted)
    box = outcome.contestants["black_box"].box
    assert box is not None  # the black box is one
    predicted = black_box.predicted(problem, found.base.v, box)
    seen = evaluate(problem, found.fit.v, (), found.fit.noise)
    with_law = found.law.fitted if chunks is found.problem.chunks else found.law.heldout

    def less(e: Float[np.ndarray, "n s"]) -> Float[np.ndarray, "C t s"]:
        """The effects' innovations less decorrelated ones of the rows that count."""
        part = np.zeros_like(fitted)
        part[np.asarray(chunks.counts)] = e @ np.linalg.inv(problem.whiten).T
        return fitted - part

    nameless = (
        base - predicted[..., : base.shape[-1]],
        less(whiteness(problem, seen).predicted),
        less(seen.e - with_law),
    )
    return max((localisation.excess(problem.augmented, chunks, base, e) for e in nameless), key=lambda e: e.nats.sum())


def _located(found: Explanation, sessions: Sessions, outcome: Outcome, whiteness: Whiteness) -> dict[str, Any]:
    problem, verdict = found.problem, outcome.concluded.verdict
    if verdict not in MISMATCH:
        return {"outputs": [], "regimes": [], "intervals": [], "depends_on": []}
    where = _excess(found, outcome, problem.chunks)
    return {
        "outputs": localisation.outputs(problem.augmented, where),
        "regimes": _regimes(found, where),
        "intervals": _intervals(found, where, sessions.fitted),
        "depends_on": _depends_on(found, whiteness) if verdict == "unexplained" else [],
    }


def _depends_on(found: Explanation, whiteness: Whiteness) -> list[dict[str, Any]]:
    """What the nameless depends on: its own past by what that foretells of it, else by shares of the law's gain."""
    gains: dict[str, float] = {}
    for term in found.law.terms:
        for name in term.depends_on:
            gains[name] = gains.get(name, 0.0) + term.gain
    total = sum(t.gain for t in found.law.terms)
    depends = [("its own past", float(whiteness.share.max())), *((name, gain / total) for name, gain in gains.items())]
    return [{"input": i, "share": s} for i, s in sorted(depends, key=lambda d: -d[1]) if s > 0]


def _scattered(s: NoiseEffect) -> dict[str, Any]:
    return {
        "id": s.id, **SCATTERED, "probability": s.odds[s.id], "channels": [], "outputs": list(s.outputs),
        "statement": s.statement, "constants": s.constants, "credible_set": credible_set(s.odds), "gain_nats": s.gain,
        "misfit_nats": 0.0, "heldout_gain_nats": s.heldout_gain, "support": NO_LIMITS | {"kind": "always"},
    }  # fmt: skip


def _effect(found: Explanation, member: Member, fitted: Sequence[Recording]) -> dict[str, Any]:
    problem, hypothesis = found.problem, member.hypothesis
    constants = posterior.constants(problem, found.fit, hypothesis, found.sd, member.gain)
    outputs = hypothesis.outputs or tuple(f.name for f in problem.augmented.simulator.schema.outputs)
    if isinstance(hypothesis.support, Window) and hypothesis.effect.event:
        constants += posterior.edges(problem, found.fit, hypothesis, hypothesis.support)
    support = _support(found, hypothesis.support, fitted)
    return {
        "id": hypothesis.effect.id, "form": hypothesis.effect.form, "where": hypothesis.where,
        "probability": member.odds[hypothesis.effect.id], "channels": list(hypothesis.channels),
        "outputs": list(outputs), "statement": wording.effect(hypothesis, constants) + wording.acts(support),
        "constants": constants, "credible_set": credible_set(member.odds),
        "gain_nats": member.gain, "misfit_nats": member.misfit,
        "heldout_gain_nats": gain(problem, found.unseen, evaluate(problem, member.without.v, ()), found.fit),
        "support": support,
    }  # fmt: skip


def _support(found: Explanation, support: Support, fitted: Sequence[Recording]) -> dict[str, Any]:
    """Where and when an effect acts."""
    match support:
        case Always():
            limits = {"kind": "always"}
        case From(from_s):
            limits = {"kind": "from", "from_s": from_s}
        case Window(session, from_s, to_s):
            limits = {"kind": "window", "session": fitted[session].name, "from_s": from_s, "to_s": to_s}
        case Since():
            limits = {"kind": "since_baseline"}
        case regime:
            limits = {"kind": "regime", "regime": rule(found.problem.augmented.layout, regime)}
    return NO_LIMITS | limits


def _regimes(found: Explanation, where: localisation.Excess) -> list[dict[str, Any]]:
    """The regimes to which effects are restricted, then those of other features that hold most of the excess."""
    layout, excess = found.problem.augmented.layout, localisation.regimes(where)
    supports = (m.hypothesis.support for m in found.members)
    own = list(dict.fromkeys(s for s in supports if isinstance(s, Regime)))
    names = tuple(f"{features(layout)[regime.feature].name} " for regime in own)
    others = (r for r in excess if not r["regime"].startswith(names))
    return [*(localisation.share(where, layout, regime) for regime in own), *others]


def _intervals(found: Explanation, where: localisation.Excess, fitted: Sequence[Recording]) -> list[dict[str, Any]]:
    """When effects act that do not act throughout; else where the excess is, if it is in one place."""
    intervals = []
    for support in (m.hypothesis.support for m in found.members):
        match support:
            case From(from_s):
                affected, to_s = fitted, np.inf
            case Window(session, from_s, to_s):
                affected = [fitted[session]]
            case _:
                continue
        for r in affected:
            duration = float(r.time_s[-1] - r.time_s[0])
            if duration > from_s:
                intervals.append({"session": r.name, "from_s": from_s, "to_s": min(to_s, duration), "share": None})
    return intervals or localisation.intervals(where, fitted)
