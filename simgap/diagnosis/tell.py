"""A diagnosis as it is told: the statement that becomes diagnosis.json, and the numbers behind its pictures."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis import black_box, confidence, judge, locate, pictures, scatter_pictures, words
from simgap.diagnosis.experiment import Experiment
from simgap.diagnosis.explain import EXPLAINED, Explanation
from simgap.diagnosis.fit import evaluate, raw_innovations
from simgap.diagnosis.heldout import gain
from simgap.diagnosis.innovations import Chunks
from simgap.diagnosis.judge import Contestant, Judgement
from simgap.diagnosis.left_over import LeftOver, left_over
from simgap.diagnosis.rivals import Member
from simgap.diagnosis.scatter_claim import Scatter
from simgap.diagnosis.since import leaves
from simgap.effects import CATALOGUE
from simgap.effects.regime import EVERYWHERE, features
from simgap.effects.regime import words as rule
from simgap.types import Recording

SEEN = 8.0
"""Nats that an effect of usual strength must be able to gain for the recordings to show it."""
CREDIBLE = 0.95
SCATTERED = {"form": "scatter", "where": "all"}
"""Of every effect on the scatter."""
MISMATCH = ("missing_physics", "unexplained")
"""Verdicts with something to locate."""


class Sessions(NamedTuple):
    """Recordings by what they served."""

    training: Sequence[Recording]
    heldout: Sequence[Recording]
    baseline: Sequence[Recording]

    @property
    def fitted(self) -> list[Recording]:
        """In the order in which the chunks number them."""
        return [*self.baseline, *self.training]


class Plan(NamedTuple):
    """An experiment and the two effects that it tells apart."""

    experiment: Experiment
    separates: tuple[str, str]


def statement(
    name: str,
    found: Explanation,
    sessions: Sessions,
    contestants: dict[str, Contestant],
    judged: Judgement,
    plan: Plan | None,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """All six answers in plain values, in the layout of diagnosis.json."""
    layout = found.problem.augmented.layout
    share, verdict = _verdict(found, judged, rng)
    # Where no name stands, what is left over is what the simulator leaves by itself.
    left = leaves(found.problem, found.base, found.baseline) if verdict == "unexplained" else found.left
    members = [(found.names(m), _effect(found, m, sessions.fitted)) for m in found.members]
    effects = [e for sure, e in members if sure] + [_scattered(s) for s in found.scattered]
    doubtful = [e for sure, e in members if not sure]
    if verdict == "unexplained":
        effects, doubtful = [], [*effects, *doubtful]
    told = {
        "schema": 1, "simulator": name, "verdict": verdict,
        "recordings": {
            "training_sessions": [r.name for r in sessions.training],
            "heldout_sessions": [r.name for r in sessions.heldout],
            "baseline": [r.name for r in sessions.baseline] or None,
            "transitions": int(np.asarray(found.problem.chunks.counts).sum()),
            "duration_s": float(sum(r.time_s[-1] - r.time_s[0] for r in (*sessions.fitted, *sessions.heldout))),
        },
        "located": _located(found, sessions, contestants, verdict, left),
        "effects": effects, "resembles": doubtful, "left_over": _left(found, left), "law": _law(found),
        "alternatives": _alternatives(found.members),
        "experiment": plan and {"statement": words.experiment(plan.experiment, plan.separates),
                                "commands": "experiment.csv", "separates": list(plan.separates)},
        "parameters": _parameters(found),
        "fit": {
            "heldout_sessions": [r.name for r in sessions.heldout],
            "models": {model: judge.scores(layout, j, rng) for model, j in judged.heldout.items()},
            "explained_share": share and share["value"], "explained_share_ci95": share and share["ci95"],
        },
        "blind": _blind(found), "rounds": _rounds(found), "notes": _notes(sessions),
    }  # fmt: skip
    return {**told, "statement": words.statement(told)}


def evidence(
    found: Explanation, sessions: Sessions, contestants: dict[str, Contestant], verdict: str, plan: Plan | None
) -> dict[str, Any]:
    """Arrays for the pictures."""
    problem = found.problem
    trained, held = (_excess(found, contestants, verdict, c) for c in (problem.chunks, found.unseen))
    longest = max(sessions.heldout, key=lambda r: len(r.time_s))
    return {
        "heat": locate.heat(problem.augmented, trained),
        "strips": [*locate.strips(trained, sessions.fitted, False), *locate.strips(held, sessions.heldout, True)],
        "laws": [p for m in found.members for p in pictures.laws(problem, found.fit, m.candidate, trained)]
        + [SCATTERED | {"effect": s.id} | p for s in found.scattered for p in scatter_pictures.picture(s.shown)],
        "rollouts": pictures.rollouts(problem, longest, contestants),
        "experiment": plan and pictures.commands(problem, plan.experiment),
    }


def _verdict(found: Explanation, judged: Judgement, rng: np.random.Generator) -> tuple[dict[str, Any] | None, str]:
    """Share of the black box's gain that named physics makes, and the verdict.

    With a baseline there is no such share: most of what a black box finds was there before.
    """
    if not judged.heldout:
        return None, "missing_physics" if found.members or found.scattered else "nothing"
    heldout = judged.heldout
    refitted = heldout["refitted"]
    augmented = heldout.get("augmented", refitted)
    share = None if found.baseline else judge.explained_share(refitted, augmented, heldout["black_box"], rng)
    named = any(found.names(m) for m in found.members)
    little = share is not None and share["ci95"][1] < EXPLAINED
    astray = named and any(judge.worse(j["refitted"], j["augmented"], rng) for j in judged)
    if named and not little and not astray:
        return share, "missing_physics"
    # What is periodic, or odd in single rows, can be foretold in part.
    accounted = any(s.id == "gait_oscillation" or s.rare for s in found.scattered)
    nameless = found.left.nats.any() or found.law.terms
    if found.members or share is not None or (nameless and not accounted):
        return share, "unexplained"
    if found.scattered:
        return share, "missing_physics"
    moved = judge.difference(heldout["as_is"], refitted, rng)["ci95"][0] > 0
    return share, "parameters_only" if moved else "nothing"


def _left(found: Explanation, left: LeftOver) -> dict[str, Any]:
    """What can still be foretold of the innovations, by output."""
    fields = found.problem.augmented.simulator.schema.state
    told = [{"name": f.name, "share": float(p)} for f, p in zip(fields, left.share, strict=True) if p]
    return {"nats": float(left.nats.sum()), "outputs": sorted(told, key=lambda o: -o["share"])}


def _law(found: Explanation) -> list[dict[str, Any]]:
    """What the law without a name depends on, term by term."""
    return [{"axis": t.axis, "depends_on": list(t.depends_on), "gain_nats": t.gain} for t in found.law.terms]


def _excess(found: Explanation, contestants: dict[str, Contestant], verdict: str, chunks: Chunks) -> locate.Excess:
    """What the best explanation gains over the refitted simulator: named physics, or else what names nothing.

    Of the latter, the best one: the black box, or the effects together with a law without a name, or with what can be
    foretold of what they leave.
    """
    problem = found.problem._replace(chunks=chunks)
    base, fitted = (raw_innovations(problem, f.v) for f in (found.base, found.fit))
    if verdict == "missing_physics":
        return locate.excess(problem.augmented, chunks, base, fitted)
    box = contestants["black_box"].box
    assert box is not None  # the black box is one
    predicted = black_box.predicted(problem, found.base.v, box)
    seen = evaluate(problem, found.fit.v, (), found.fit.noise)
    with_law = found.law.fitted if chunks is found.problem.chunks else found.law.heldout

    def less(e: Float[np.ndarray, "n s"]) -> Float[np.ndarray, "C t s"]:
        """The effects' innovations less decorrelated ones of the rows that count."""
        part = np.zeros_like(fitted)
        part[np.asarray(chunks.counts)] = e @ np.linalg.inv(problem.whiten).T
        return fitted - part

    nameless = (base - predicted, less(left_over(problem, seen).foretold), less(seen.e - with_law))
    return max((locate.excess(problem.augmented, chunks, base, e) for e in nameless), key=lambda e: e.nats.sum())


def _located(
    found: Explanation,
    sessions: Sessions,
    contestants: dict[str, Contestant],
    verdict: str,
    left: LeftOver,
) -> dict[str, Any]:
    problem = found.problem
    if verdict not in MISMATCH:
        return {"outputs": [], "regimes": [], "intervals": [], "depends_on": []}
    where = _excess(found, contestants, verdict, problem.chunks)
    return {
        "outputs": locate.outputs(problem.augmented, where),
        "regimes": _regimes(found, where),
        "intervals": _intervals(found, where, sessions.fitted),
        "depends_on": _depends_on(found, left) if verdict == "unexplained" else [],
    }


def _depends_on(found: Explanation, left: LeftOver) -> list[dict[str, Any]]:
    """What the nameless depends on: its own past by what that foretells of it, else by shares of the law's gain."""
    gains: dict[str, float] = {}
    for term in found.law.terms:
        for name in term.depends_on:
            gains[name] = gains.get(name, 0.0) + term.gain
    total = sum(t.gain for t in found.law.terms)
    depends = [("its own past", float(left.share.max())), *((name, gain / total) for name, gain in gains.items())]
    return [{"input": i, "share": s} for i, s in sorted(depends, key=lambda d: -d[1]) if s > 0]


def _scattered(s: Scatter) -> dict[str, Any]:
    return {
        "id": s.id, **SCATTERED, "probability": 1.0, "channels": [], "outputs": list(s.outputs),
        "statement": s.statement, "constants": s.constants, "credible_set": [s.id], "gain_nats": s.gain,
        "heldout_gain_nats": s.heldout_gain, "from_s": None, "regime": None,
    }  # fmt: skip


def _effect(found: Explanation, member: Member, fitted: Sequence[Recording]) -> dict[str, Any]:
    problem, candidate = found.problem, member.candidate
    constants = confidence.constants(problem, found.fit, candidate, found.sd, member.gain)
    cumulative, credible = 0.0, []
    for effect, p in member.odds.items():
        credible.append(effect)
        cumulative += p
        if cumulative >= CREDIBLE:
            break
    outputs = candidate.outputs or tuple(f.name for f in problem.augmented.simulator.schema.state)
    when = member.when
    if when is not None and candidate.effect.event:
        step = problem.scales.time_step
        constants += [{"name": n, "value": t, "unit": "s", "ci95": [t - 3 * step, t + 3 * step]}
                      for n, t in (("from", when.from_s), ("to", when.to_s))]  # fmt: skip
    regime = rule(problem.augmented.layout, when.regime) if when is not None and when.regime is not None else None
    during = words.during(when, fitted[when.session].name if when and when.session is not None else None, regime)
    return {
        "id": candidate.effect.id, "form": candidate.effect.form, "where": candidate.where,
        "probability": member.odds[candidate.effect.id], "channels": list(candidate.channels),
        "outputs": list(outputs), "statement": words.effect(candidate, constants) + during, "constants": constants,
        "credible_set": credible, "gain_nats": member.gain,
        "heldout_gain_nats": gain(problem, found.unseen, evaluate(problem, member.without.v, ()), found.fit),
        "from_s": when.from_s if when is not None and regime is None else None, "regime": regime,
    }  # fmt: skip


def _regimes(found: Explanation, where: locate.Excess) -> list[dict[str, Any]]:
    """The regime to which an effect is restricted, then those that hold most of the excess."""
    layout, told = found.problem.augmented.layout, locate.regimes(where)
    if found.regime == EVERYWHERE:
        return told
    name = features(layout)[found.regime.feature].name
    return [locate.share(where, layout, found.regime), *(r for r in told if not r["when"].startswith(f"{name} "))]


def _intervals(found: Explanation, where: locate.Excess, fitted: Sequence[Recording]) -> list[dict[str, Any]]:
    """When effects act that do not act throughout; else where the excess is, if it is in one place."""
    told = []
    for when in (m.when for m in found.members if m.when is not None and m.when.regime is None):
        for s, r in enumerate(fitted):
            if when.session in (None, s) and r.time_s[-1] - r.time_s[0] > when.from_s:
                end = min(when.to_s, float(r.time_s[-1] - r.time_s[0]))
                told.append({"session": r.name, "from_s": when.from_s, "to_s": end, "share": None})
    return told or locate.intervals(where, fitted)


def _alternatives(members: Sequence[Member]) -> list[dict[str, Any]]:
    """Other sets: one member replaced by what could stand in its place."""
    ids = [m.candidate.effect.id for m in members]
    return [
        {"effects": [*ids[:i], other, *ids[i + 1 :]], "probability": p}
        for i, m in enumerate(members)
        for other, p in m.odds.items()
        if other != ids[i] and p > 0.001
    ]


def _parameters(found: Explanation) -> dict[str, Any]:
    simulator = found.problem.augmented.simulator
    names = [p.name for p in simulator.parameters]
    before, after = (dict(zip(names, map(float, np.asarray(f.v.phi)), strict=True)) for f in (found.as_is, found.fit))
    width = dict(zip(names, confidence.Z95 * found.sd.phi, strict=True))
    return {
        "before": before, "after": after,
        "ci95": {n: [after[n] - float(width[n]), after[n] + float(width[n])] for n in names},
        "units": {p.name: p.unit for p in simulator.parameters},
        "ranges": {p.name: [p.low, p.high] for p in simulator.parameters},
    }  # fmt: skip


def _blind(found: Explanation) -> list[dict[str, str]]:
    """Effects that these recordings could not have shown at a usual strength."""
    power: dict[str, float] = {}
    for s in found.rounds[0].screening.found:
        power[s.candidate.effect.id] = max(power.get(s.candidate.effect.id, 0.0), s.power)
    present = {e.id for e, sites in zip(CATALOGUE, found.problem.augmented.sites, strict=True) if sites}
    weak = {e: p for e, p in power.items() if p < SEEN and e in present}
    return [{"effect": e, "reason": words.blind(p)} for e, p in weak.items()]


def _rounds(found: Explanation) -> list[dict[str, Any]]:
    return [
        {
            "threshold_nats": r.screening.threshold / 2, "p_value": r.screening.p_value, "accepted": r.accepted,
            "candidates": [
                {"effect": t.candidate.effect.key, "where": t.candidate.where, "gain_nats": t.gain} for t in r.tried
            ] or [
                {"effect": s.candidate.effect.key, "where": s.candidate.where, "gain_nats": s.gain}
                for s in r.screening.found[:5]
            ],
        }
        for r in found.rounds
    ]  # fmt: skip


def _notes(sessions: Sessions) -> list[str]:
    notes = [] if sessions.training[0].command.shape[1] else [words.NO_COMMANDS]
    if len(sessions.heldout) < judge.LEAST_SESSIONS:
        notes.append(
            "Intervals of held-out scores are a bootstrap over pieces of the held-out sessions, which are few."
        )
    return notes
