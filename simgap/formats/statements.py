"""Statements of diagnoses as files: written in the present layout; the previous layout can also be read."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from simgap.diagnosis.report.schema import NO_LIMITS, SCHEMA
from simgap.formats.documents import read_json
from simgap.types import SimgapError

_PARTS = {
    "something_else": "more_missing", "resembles": "closest_matches", "left_over": "whiteness", "law": "nonparametric",
}  # fmt: skip
_PARAMETERS = {"before": "nominal", "after": "fitted"}
_SENSITIVITY = {
    "chance": "power", "hidden_effects": "undetectable_effects", "hidden_channels": "unexcited_channels",
}  # fmt: skip
_MODELS = {"as_is": "nominal"}


def read(path: Path) -> dict[str, Any]:
    """A statement in the present layout; SimgapError where the file holds none, or one of a later layout."""
    statement = read_json(path)
    schema = statement.get("schema") if isinstance(statement, dict) else None
    if schema not in (1, SCHEMA):
        raise SimgapError(f"{path}: `schema` is {schema}; this version of simgap reads 1 and {SCHEMA}. Diagnose again.")
    return _started(upgraded(statement) if schema == 1 else statement)


def upgraded(statement: Mapping[str, Any]) -> dict[str, Any]:
    """A statement of layout 1 in layout 2; parts that it lacks stay absent."""
    new: dict[str, Any] = _renamed(statement, _PARTS) | {"schema": SCHEMA}
    for part, change in (
        ("effects", lambda effects: [_effect(e) for e in effects]),
        ("closest_matches", lambda effects: [_effect(e) for e in effects]),
        ("parameters", lambda parameters: _renamed(parameters, _PARAMETERS)),
        ("sensitivity", lambda seen: _renamed(seen, _SENSITIVITY)),
        ("rounds", lambda rounds: [_renamed(r, {"candidates": "hypotheses"}) for r in rounds]),
        ("located", _located),
        ("fit", _fit),
        ("replay", _replay),
    ):
        if new.get(part):
            new[part] = change(new[part])
    return new


def _started(statement: dict[str, Any]) -> dict[str, Any]:
    """A statement whose model file has `start`: before, one share, `servo_share`, stood for all position servos."""
    kept = statement.get("model_file") or {}
    if "servo_share" not in kept:
        return statement
    kept = dict(kept)
    share, servos = kept.pop("servo_share"), [n for n in statement["parameters"]["nominal"] if n.startswith("kp ")]
    return {**statement, "model_file": kept | {"start": {} if share == 1 else dict.fromkeys(servos, share)}}


def _renamed(values: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    return {names.get(name, name): value for name, value in values.items()}


def _effect(effect: Mapping[str, Any]) -> dict[str, Any]:
    """An effect with a support in place of a time and a regime."""
    changed = dict(effect)
    from_s, regime = changed.pop("from_s", None), changed.pop("regime", None)
    ends = {c["name"]: c["value"] for c in changed.get("constants", [])}
    if regime is not None:
        support = {"kind": "regime", "regime": regime}
    elif "to" in ends:
        support = {"kind": "window", "from_s": from_s, "to_s": ends["to"]}
    else:
        support = {"kind": "always"} if from_s is None else {"kind": "from", "from_s": from_s}
    return {**changed, "support": NO_LIMITS | support}


def _located(located: Mapping[str, Any]) -> dict[str, Any]:
    return {**located, "regimes": [_renamed(r, {"when": "regime"}) for r in located.get("regimes", [])]}


def _fit(fit: Mapping[str, Any]) -> dict[str, Any]:
    worse = [{**w, **{key: _MODELS.get(w[key], w[key]) for key in ("model", "than")}} for w in fit.get("worse", [])]
    return {**fit, "models": _renamed(fit.get("models", {}), _MODELS), "worse": worse}


def _replay(replay: Mapping[str, Any]) -> dict[str, Any]:
    positions = [{**p, "errors": _renamed(p["errors"], _MODELS)} for p in replay.get("positions", [])]
    return {**replay, "positions": positions}
