"""The report of a diagnosis: the statement that becomes diagnosis.json, and the numbers behind its figures."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from simgap.diagnosis.hypotheses.support import Always, From, Since, Support, Window
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.misfit.whiteness import Whiteness
from simgap.diagnosis.inference.noise.effect import NoiseEffect
from simgap.diagnosis.inference.search import posterior
from simgap.diagnosis.inference.two_sample import whiteness_of
from simgap.diagnosis.likelihood.segments import scorable
from simgap.diagnosis.report import figures, forecasts, localisation, noise_figures, wording
from simgap.diagnosis.report.answers import (
    alternatives_of,
    beyond_of,
    change_of,
    credible_set,
    notes_of,
    parameters_of,
    rounds_of,
    sensitivity_of,
    untested_of,
)
from simgap.diagnosis.report.experiment import Experiment
from simgap.diagnosis.report.hidden_states import hidden_effects, notes
from simgap.diagnosis.report.located import excess, located
from simgap.diagnosis.report.schema import NO_LIMITS, SCHEMA
from simgap.diagnosis.validation import scores
from simgap.diagnosis.validation.adequacy import Verdict
from simgap.diagnosis.validation.black_box import BlackBox
from simgap.diagnosis.validation.forecast import Contestant
from simgap.diagnosis.validation.scores import Judgement
from simgap.diagnosis.validation.sensitivity import Sensitivity
from simgap.effects.regime import words as rule
from simgap.types import Recording, Sessions

SCATTERED = {"form": "scatter", "where": "all"}
"""Keys that all effects on the noise share."""


class Plan(NamedTuple):
    """An experiment and the two effects that it separates."""

    experiment: Experiment
    separates: tuple[str, str]


class Outcome(NamedTuple):
    """judged: scores of the contestants. seen: what the recordings could have shown. beyond: the explanation when
    parameters may leave their ranges, if some would. concluded: the verdict."""

    contestants: dict[str, Contestant]
    judged: Judgement
    seen: Sensitivity
    beyond: Explanation | None
    concluded: Verdict

    @property
    def black_box(self) -> BlackBox:
        box = self.contestants["black_box"].box
        assert box is not None  # this contestant always has one
        return box


def statement(
    name: str, found: Explanation, sessions: Sessions, outcome: Outcome, plan: Plan | None, rng: np.random.Generator
) -> dict[str, Any]:
    """The diagnosis in plain values, in the layout of diagnosis.json."""
    problem, concluded = found.problem, outcome.concluded
    verdict, share, only = concluded.verdict, concluded.share, found.elsewhere
    # If no effect is named, the residuals are those of the refitted simulator.
    whiteness = whiteness_of(problem, found.base, found.baseline) if verdict == "unexplained" else found.whiteness
    effects = [_effect(found, i, concluded, sessions.fitted) for i, named in enumerate(concluded.named) if named]
    effects += hidden_effects(found) if verdict == "missing_physics" else []
    closest = [_effect(found, i, concluded, sessions.fitted) for i in _closest(found, concluded)]
    noise_effects = [_noise_effect(s, concluded.noise_known(s)) for s in found.noise_effects]
    if concluded.noise_named:
        effects += noise_effects
    else:
        closest += [e for e in noise_effects if e["heldout_gain_nats"] > 0]
    content = {
        "schema": SCHEMA, "simulator": name, "verdict": verdict,
        "recordings": {
            "training_sessions": [r.name for r in sessions.training],
            "heldout_sessions": [r.name for r in sessions.heldout],
            "baseline": [r.name for r in sessions.baseline] or None,
            "transitions": scorable(sessions.fitted), "searched": int(np.asarray(problem.chunks.counts).sum()),
            "heldout_only": only and {"effect": only.hypothesis.effect.id, "where": only.hypothesis.where},
            "duration_s": float(sum(r.time_s[-1] - r.time_s[0] for r in (*sessions.fitted, *sessions.heldout))),
        },
        "located": located(found, sessions.fitted, verdict, outcome.black_box, whiteness),
        "effects": effects, "more_missing": concluded.something_else, "found": _found(found, concluded),
        "closest_matches": closest, "whiteness": _whiteness(found, whiteness), "nonparametric": _law(found),
        "alternatives": alternatives_of(found, concluded),
        "experiment": plan and {"statement": wording.experiment(plan.experiment, plan.separates),
                                "commands": "experiment.csv", "separates": list(plan.separates)},
        "parameters": parameters_of(found) | {"moved": concluded.parameters_moved, "beyond": beyond_of(outcome.beyond)},
        "fit": {
            "heldout_sessions": [r.name for r in sessions.heldout], "least_rows": scores.LEAST_ROWS,
            "models": {model: scores.scores(problem.augmented.layout, j, rng)
                       for model, j in outcome.judged.heldout.items()},
            "explained_share": share and share["value"], "explained_share_ci95": share and share["ci95"],
            "change": change_of(outcome.judged.heldout, rng),
            "black_box_better_at": list(concluded.beaten_at),
            "worse": [{"model": b, "than": a, "at": at} for (a, b), at in concluded.worse_at.items() if at],
        },
        "sensitivity": sensitivity_of(outcome.seen), "rounds": rounds_of(found), "untested": untested_of(found),
        "notes": [*notes_of(found, sessions), *notes(found)],
    }  # fmt: skip
    content |= {"insufficient": wording.insufficient(content)}
    return {**content, "warnings": forecasts.warnings(content), "statement": wording.statement(content)}


def evidence(found: Explanation, sessions: Sessions, outcome: Outcome, plan: Plan | None) -> dict[str, Any]:
    """Arrays for the figures."""
    problem = found.problem
    verdict, box = outcome.concluded.verdict, outcome.black_box
    trained, held = (excess(found, verdict, box, chunks) for chunks in (problem.chunks, found.unseen))
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


def _closest(found: Explanation, concluded: Verdict) -> list[int]:
    """Unnamed effects that are closest matches: they gain on held-out sessions, and their constants are determined."""
    problem, fit, sd = found.problem, found.fit, found.sd
    unnamed = (i for i, possible in enumerate(concluded.possible) if possible and not concluded.named[i])
    return [
        i
        for i in unnamed
        if concluded.heldout_gains[i] > 0
        and posterior.determined(problem, fit, found.members[i].hypothesis, sd, found.members[i].gain)
    ]


def _whiteness(found: Explanation, whiteness: Whiteness) -> dict[str, Any]:
    """Predictability of the innovations, by output."""
    fields = found.problem.augmented.simulator.schema.outputs
    outputs = [{"name": f.name, "share": float(p)} for f, p in zip(fields, whiteness.share, strict=True) if p]
    return {"nats": float(whiteness.nats.sum()), "outputs": sorted(outputs, key=lambda o: -o["share"])}


def _law(found: Explanation) -> list[dict[str, Any]]:
    """The nonparametric law, term by term."""
    return [{"axis": t.axis, "depends_on": list(t.depends_on), "gain_nats": t.gain} for t in found.law.terms]


def _noise_effect(s: NoiseEffect, known: float) -> dict[str, Any]:
    return {
        "id": s.id, **SCATTERED, "probability": known * s.odds[s.id], "outside": 1.0 - known,
        "channels": [], "outputs": list(s.outputs),
        "statement": s.statement, "constants": s.constants, "credible_set": credible_set(s.odds), "gain_nats": s.gain,
        "misfit_nats": 0.0, "heldout_gain_nats": s.heldout_gain, "support": NO_LIMITS | {"kind": "always"},
    }  # fmt: skip


def _effect(found: Explanation, i: int, concluded: Verdict, fitted: Sequence[Recording]) -> dict[str, Any]:
    """The i-th effect found."""
    member, problem, known = found.members[i], found.problem, concluded.known[i]
    hypothesis = member.hypothesis
    constants = posterior.constants(problem, found.fit, hypothesis, found.sd, member.gain)
    outputs = hypothesis.outputs or tuple(f.name for f in problem.augmented.simulator.schema.outputs)
    if isinstance(hypothesis.support, Window) and hypothesis.effect.event:
        constants += posterior.edges(problem, found.fit, hypothesis, hypothesis.support)
    support = _support(found, hypothesis.support, fitted)
    return {
        "id": hypothesis.effect.id, "form": hypothesis.effect.form, "where": hypothesis.where,
        "probability": known * member.odds[hypothesis.effect.id], "outside": 1.0 - known,
        "channels": list(hypothesis.channels), "outputs": list(outputs),
        "statement": wording.effect(hypothesis, constants, support),
        "constants": constants, "credible_set": credible_set(member.odds),
        "gain_nats": member.gain, "misfit_nats": member.misfit, "heldout_gain_nats": concluded.heldout_gains[i],
        "support": support,
    }  # fmt: skip


def _found(found: Explanation, concluded: Verdict) -> list[dict[str, Any]]:
    """Every effect found, named or not, and what speaks for and against it; none if there are no scores."""
    judged = zip(found.members, concluded.named, concluded.known, concluded.indicators, strict=False)
    return [
        {"id": m.hypothesis.effect.id, "form": m.hypothesis.effect.form, "where": m.hypothesis.where, "named": named,
         "credible_set": credible_set(m.odds), "outside": 1.0 - known, "indicators": indicators._asdict()}
        for m, named, known, indicators in judged
    ]  # fmt: skip


def _support(found: Explanation, support: Support, fitted: Sequence[Recording]) -> dict[str, Any]:
    """The support of an effect, in the layout of diagnosis.json."""
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
