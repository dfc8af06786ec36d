"""What was said of one case against its key."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

Key = Mapping[str, Any]
Statement = Mapping[str, Any]
Row = dict[str, Any]

TIME_STEP = 1 / 15
SURE = 0.95
"""Probability from which on an answer is a confident one."""
TIED = 2 / 3
"""Probability up to which a name counts as one of a tie: odds of two to one at most."""
SEEN = 3.0
"""Strength [nats] below which an effect can hardly be asked to be seen: such cases count for coverage only."""
IMPROVES = 0.15
"""Share of the 50-step error that the true form must remove for a share of that to be measurable."""
MOVED = 0.1
"""A fit has moved a parameter that it changed by more than this share."""
ONE = ("single", "duel", "regime", "onset", "engine", "real")
"""Kinds with one effect, or one cause."""
MANY = ("pair", "triple")
NO_NAME = ("null", "parameters", "outside")
"""Kinds of which no name is right: nothing is concealed, wrong parameters, or a law that no word describes."""


def judge(key: Key, statement: Statement | None, seconds: float | None, error: str | None) -> Row:
    """One row of the score. Of a case that failed nothing is known but that; it counts as nothing said."""
    statement = statement or {"verdict": "failed", "effects": [], "fit": {"models": {}}, "located": {}}
    truth = [set(e["accept"]) for e in key["effects"]] if key["kind"] not in NO_NAME else []
    effects = sorted(statement["effects"], key=lambda e: -e["gain_nats"])
    row: Row = {
        "kind": key["kind"], "truth": key.get("cause") or "+".join(e.get("cause", e["id"]) for e in key["effects"]),
        "strength": key["strength"], "target": key["target"], "size": key["recipe"]["size"],
        "poor": key["recipe"]["poor"],
        "noise": key["recipe"]["level"], "glitches": key["recipe"]["outliers"], "wild": key["recipe"]["wild"],
        "verdict": statement["verdict"], "answer": "+".join(e["id"] for e in effects),
        "probability": effects[0]["probability"] if effects else math.nan, "seconds": seconds, "error": error,
        # Of a null, "inconclusive" claims nothing; how often it is said is counted by itself.
        "right_verdict": statement["verdict"] in (*key["verdicts"], *["inconclusive"] * (key["kind"] == "null")),
        "inconclusive": statement["verdict"] == "inconclusive",
        "confident_wrong": any(_confident_wrong(e, truth) for e in effects),
        "extra": sum(not any(e["id"] in t for t in truth) for e in effects),
    }  # fmt: skip
    row |= _improvement(key, statement) | _open_loop(key, statement) | _parameter(key, statement)
    if key["kind"] in ONE:
        row |= _of_one(key, effects, truth[0])
    if "tied" in key:
        row["settled"] = _settled(key, effects, truth)
    if key["kind"] in MANY:
        row["set_f1"] = set_f1(truth, [{e["id"]} for e in effects])
        row["set_f1_tied"] = set_f1(truth, [_names(e) for e in effects])
    return row


def _settled(key: Key, effects: Sequence[Mapping[str, Any]], truth: Sequence[set[str]]) -> bool:
    """Whether only right names of a tie are left: of the effects that carry one of its names, and in their sets."""
    right = {name for names in truth for name in names}
    left = [{e["id"], *e["credible_set"]} for e in effects if e["id"] in key["tied"]]
    return bool(left) and all(names <= right for names in left)


def _names(effect: Mapping[str, Any]) -> set[str]:
    """Names that a statement gives an effect: all of its credible set where it declares a tie.

    It does if the name has at most `TIED` of the probability that the cause is among the names at all.
    """
    tied = effect["probability"] <= TIED * (1.0 - effect.get("outside", 0.0))
    return {effect["id"], *(effect["credible_set"] if tied else ())}


def set_f1(truth: Sequence[set[str]], named: Sequence[set[str]]) -> float:
    """F1 of a set of effects, each with the names that are given to it, and to be named once."""
    left, hits = list(truth), 0
    for names in named:
        hit = next((t for t in left if names & t), None)
        if hit is not None:
            left.remove(hit)
            hits += 1
    return 2 * hits / (len(truth) + len(named)) if truth or named else 1.0


def _confident_wrong(effect: Mapping[str, Any], truth: Sequence[set[str]]) -> bool:
    """A name with hardly a doubt, where neither it nor what might stand in its place is true."""
    named = {effect["id"], *effect["credible_set"]}
    return effect["probability"] >= SURE and not any(named & t for t in truth)


def _of_one(key: Key, effects: Sequence[Mapping[str, Any]], right: set[str]) -> Row:
    first = effects[0] if effects else None
    row: Row = {
        "named": first is not None, "top1": first is not None and first["id"] in right,
        "tied": first is not None and bool(_names(first) & right),
        "alone": _alone(key["effects"][0], effects, right),
        "covered": any(set(e["credible_set"]) & right for e in effects) if effects else math.nan,
        "set_size": len(first["credible_set"]) if first else math.nan,
    }  # fmt: skip
    found = next((e for e in effects if e["id"] in right), None)
    true = key["effects"][0]
    if found is not None:
        row["outputs_f1"] = _f1(set(true["outputs"]), set(found["outputs"])) if true["outputs"] else math.nan
        row |= constants(true["constants"], found["constants"]) if found["id"] == true["id"] else {}
        onset = onset_of(key)
        if onset is not None:
            said = found["support"]["from_s"]
            said = next((c["value"] for c in found["constants"] if c["name"] in ("from", "onset")), said)
            row["onset_error"] = abs(said - onset) / TIME_STEP if said is not None else math.inf
    return row


def _alone(true: Mapping[str, Any], effects: Sequence[Mapping[str, Any]], right: set[str]) -> bool:
    """Whether right names are all that is named, of channels that the effect acts on alone; no channels in the key: of
    any."""
    acts = set(true["channels"])
    return bool(effects) and all(e["id"] in right and (not acts or set(e["channels"]) <= acts) for e in effects)


def onset_of(key: Key) -> float | None:
    """When the effect begins [s], if it does not act throughout."""
    when = key["when"] or {}
    if "from_s" in when:
        return when["from_s"]
    return next((c["value"] for c in key["effects"][0]["constants"] if c["name"] in ("from", "onset")), None)


def constants(true: Sequence[Mapping[str, Any]], stated: Sequence[Mapping[str, Any]]) -> Row:
    """Relative error of the first constant that both name or that has the same unit, and whether its interval holds.

    Signs are a matter of convention between the two; sizes are compared.
    """
    for t in true:
        same = [c for c in stated if c["name"] == t["name"]] or [c for c in stated if c["unit"] == t["unit"]]
        if not same or t["name"] in ("from", "to", "onset") or not t["value"]:
            continue
        low, high = same[0]["ci95"]
        value = abs(t["value"])
        return {"constant_error": abs(abs(same[0]["value"]) - value) / value,
                "constant_held": low <= value <= high or low <= -value <= high}  # fmt: skip
    return {}


def _f1(truth: set[str], named: set[str]) -> float:
    return 2 * len(truth & named) / (len(truth) + len(named)) if truth or named else 1.0


def _improvement(key: Key, statement: Statement) -> Row:
    """Share of the true form's improvement after 50 steps on held-out sessions, of named physics and of a black box.

    Improvements are relative to the refitted simulator, in the key as in the statement.
    """
    models, errors = statement["fit"]["models"], key.get("error_50")
    if errors is None:
        return {}
    possible = 1 - errors["true"] / errors["refitted"]
    if key["kind"] == "null" or possible < IMPROVES or "error_50" not in models.get("refitted", {}):
        return {}
    refitted = models["refitted"]["error_50"]["value"]
    made = lambda model: 1 - models[model]["error_50"]["value"] / refitted if model in models else 0.0  # noqa: E731
    return {"share": made("augmented") / possible, "share_black_box": made("black_box") / possible}


def _open_loop(key: Key, statement: Statement) -> Row:
    """Error of the corrected model in open loop, in the noise with which positions are measured: at 1 nothing is left.

    corrected: with the effects that are named, or refitted where none is. Mean square over all positions.
    """
    replay, floor = statement.get("replay"), key.get("floor")
    if not replay or not floor:
        return {}
    of = lambda model: [p["errors"].get(model, p["errors"]["refitted"]) for p in replay["positions"]]  # noqa: E731
    ratio = lambda model: float(np.sqrt(np.mean(np.square(of(model)))) / floor)  # noqa: E731
    return {"open_loop": ratio("augmented"), "open_loop_nominal": ratio("nominal")}


def _parameter(key: Key, statement: Statement) -> Row:
    """Relative error, after the refit, of the parameter that is wrong in the user's model."""
    if not key.get("parameter") or "parameters" not in statement:
        return {}
    name, true = key["parameter"]
    return {"parameter_error": abs(statement["parameters"]["fitted"][name] / true - 1)}


def moved(nominal: Mapping[str, float], fitted: Mapping[str, float], key: Key) -> int:
    """How many parameters a fit has changed by more than `MOVED`, though they are right in the user's model."""
    wrong = key["parameter"][0] if key.get("parameter") else None
    return sum(abs(fitted[name] / value - 1) > MOVED for name, value in nominal.items() if value and name != wrong)


def invented_friction(joints: Iterable[str], key: Key) -> int:
    """How many of the joints that are said to have dry friction have none; no channels in the key mean all joints."""
    dry = [e["channels"] for e in key["effects"] if "coulomb_friction" in e["accept"]]
    return sum(not any(not channels or f"cmd_{joint}" in channels for channels in dry) for joint in set(joints))


RULE = re.compile(r"^(.*) ([<>]) (-?[0-9.e+-]+)( \S+)?$")


def rows_of(rule: str, features: Mapping[str, Float[np.ndarray, "..."]]) -> Float[np.ndarray, "..."] | None:
    """Where a rule such as `reach > 0.9 m` holds; None where it is said in another quantity than is known here."""
    match = RULE.match(rule)
    if match is None or match[1] not in features:
        return None
    values, edge = features[match[1]], float(match[3])
    return values > edge if match[2] == ">" else values < edge


def overlap(truth: str, rules: Sequence[str], features: Mapping[str, Float[np.ndarray, "..."]]) -> float:
    """Rows that both the true regime and the first of the rules hold, of those that either does."""
    a = rows_of(truth, features)
    b = rows_of(rules[0], features) if rules else None
    if a is None or b is None:
        return 0.0
    return float((a & b).sum() / max((a | b).sum(), 1))
