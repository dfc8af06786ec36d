"""Parts of the statement: parameters, alternatives, rounds, notes."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from simgap.diagnosis.config import CREDIBLE, POWER, Z95
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.search import posterior
from simgap.diagnosis.likelihood.segments import scorable
from simgap.diagnosis.report import wording
from simgap.diagnosis.report.names import quantity, title
from simgap.diagnosis.validation import scores
from simgap.diagnosis.validation.adequacy import Verdict
from simgap.diagnosis.validation.sensitivity import Sensitivity
from simgap.types import Parameter, Sessions


def credible_set(odds: Mapping[str, float]) -> list[str]:
    """The most probable ids whose probabilities sum to `CREDIBLE`."""
    cumulative, credible = 0.0, []
    for effect, p in odds.items():
        credible.append(effect)
        cumulative += p
        if cumulative >= CREDIBLE:
            break
    return credible


def alternatives_of(found: Explanation, concluded: Verdict) -> list[dict[str, Any]]:
    """Other sets of effects: one effect is replaced by an alternative."""
    members = zip(found.members, concluded.known or [1.0] * len(found.members), strict=True)
    odds = [(m.hypothesis.effect.id, {effect: k * p for effect, p in m.odds.items()}) for m, k in members]
    odds += [(s.id, {e: concluded.noise_known(s) * p for e, p in s.odds.items()}) for s in found.noise_effects]
    ids = [effect for effect, _ in odds]
    return [
        {"effects": [*ids[:i], other, *ids[i + 1 :]], "probability": p}
        for i, (own, probabilities) in enumerate(odds)
        for other, p in probabilities.items()
        if other != own and p > 0.001
    ]


def parameters_of(found: Explanation) -> dict[str, Any]:
    simulator = found.problem.augmented.simulator
    names = [p.name for p in simulator.parameters]
    low, high = np.array([(p.low, p.high) for p in simulator.parameters], float).reshape(-1, 2).T
    phi, sd = found.parameters
    width = Z95 * sd
    ends = (phi - width, phi + width)
    nominal = np.asarray(found.nominal.v.phi, float)
    nominal, fitted, *ends = (np.clip(a, low, high).tolist() for a in (nominal, phi, *ends))
    return {
        "nominal": dict(zip(names, nominal, strict=True)), "fitted": dict(zip(names, fitted, strict=True)),
        "ci95": {n: list(between) for n, *between in zip(names, *ends, strict=True)},
        "at_bound": list(posterior.at_bound(found.problem, found.fit)),
        "undetermined": [n for n, seen in zip(names, found.sd.seen, strict=True) if not seen],
        "units": {p.name: p.unit for p in simulator.parameters},
        "ranges": {p.name: [p.low, p.high] for p in simulator.parameters},
    }  # fmt: skip


def beyond_of(loose: Explanation | None) -> dict[str, float]:
    """Fitted values of the parameters outside their ranges, if nothing else is missing with these values."""
    if loose is None or loose.anything:
        return {}
    values = zip(loose.problem.augmented.simulator.parameters, map(float, loose.fit.v.phi), strict=True)
    return {p.name: value for p, value in values if not p.low <= value <= p.high}


def change_of(judged: Mapping[str, scores.Judged], rng: np.random.Generator) -> dict[str, Any] | None:
    """Relative change of the error by the effects at the longest horizon, from the better of the models without them.

    None if no effect was found, or if nothing could be scored.
    """
    if "augmented" not in judged:
        return None
    last = len(scores.horizons(judged["augmented"])) - 1
    than = min(("nominal", "refitted"), key=lambda model: scores.relative_error(judged[model], last)[0])
    change = scores.changes(judged[than], judged["augmented"], rng)[last]
    return {"than": than, "at": scores.HORIZONS[last], **change}


def sensitivity_of(seen: Sensitivity) -> dict[str, Any]:
    """What could have been found, and what could not."""
    return {
        "needed_nats": seen.needed, "power": POWER, "segments": seen.segments, "least_segments": seen.least_segments,
        "least_rows": seen.least_rows, "undetectable_effects": seen.undetectable_effects,
        "unexcited_channels": seen.unexcited_channels, "imitated_effects": seen.imitated_effects,
        "effects": [{"effect": v.effect, "where": v.where, "constant": v.constant, "size": v.size, "unit": v.unit}
                    for v in seen.visible],
    }  # fmt: skip


def rounds_of(found: Explanation) -> list[dict[str, Any]]:
    return [
        {
            "threshold_nats": r.screening.threshold / 2, "p_value": r.p_value, "accepted": r.accepted,
            "hypotheses": [
                {"effect": t.hypothesis.effect.key, "where": t.hypothesis.where, "gain_nats": t.gain} for t in r.tried
            ] or [
                {"effect": s.hypothesis.effect.key, "where": s.hypothesis.where, "gain_nats": s.gain}
                for s in r.screening.found[:5]
            ],
        }
        for r in found.rounds
    ]  # fmt: skip


def untested_of(found: Explanation) -> list[str]:
    """Hypotheses that no round could test: the simulator does not stay finite with them."""
    return list(dict.fromkeys(found.rounds[0].screening.untested))  # once for all supports


def notes_of(found: Explanation, sessions: Sessions) -> list[str]:
    notes = [] if found.problem.augmented.layout.schema.command else [wording.NO_COMMANDS]
    ends, parameters = posterior.at_bound(found.problem, found.fit), found.problem.augmented.simulator.parameters
    notes += [_at_edge(p, ends[p.name]) for p in parameters if p.name in ends]
    notes += [
        f"{p.name} is not determined: the recordings do not depend on it, or its derivative is not finite."
        for p, seen in zip(parameters, found.sd.seen, strict=True)
        if not seen
    ]
    notes += [
        f"{title(effect)} was found by the last search alone, and not by the one before: its name is not certain."
        for effect in sorted(found.unsettled)
    ]
    if untested := untested_of(found):
        effects = ", ".join(map(title, untested))
        notes.append(f"Could not test {effects}: the simulator does not stay finite there.")
    searched, recorded = int(np.asarray(found.problem.chunks.counts).sum()), scorable(sessions.fitted)
    if searched < recorded:
        notes.append(f"{searched:,} of {recorded:,} transitions were searched, in pieces at regular intervals.")
    if len(sessions.heldout) < scores.LEAST_SESSIONS:
        note = "There are few held-out sessions: intervals of their scores are a bootstrap over pieces of sessions."
        notes.append(note)
    return notes


def _at_edge(parameter: Parameter, end: float) -> str:
    beyond, at = "smaller" if end == parameter.low else "larger", quantity({"value": end, "unit": parameter.unit})
    edge = f"{parameter.name} is at the edge of its range ({at.strip()})"
    return f"{edge}: widen the range if {beyond} values are plausible."
