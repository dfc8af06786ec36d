"""The findings of a diagnosis in the terms of the model: values as in its XML, and the XML with the findings in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.report import wording
from simgap.diagnosis.report.names import number
from simgap.effects.augmented import Augmented
from simgap.effects.behind_joints import BEHIND_JOINTS
from simgap.effects.stepping import terms_of
from simgap.engines import Engine, Term
from simgap.simulators.mujoco.engine import MujocoEngine
from simgap.simulators.mujoco.patch import Patched, patch
from simgap.simulators.mujoco.replay import rescaling
from simgap.simulators.mujoco.servo_errors import servo_errors, words
from simgap.types import Recording, SimgapError

if TYPE_CHECKING:
    from simgap.diagnosis.diagnose import AugmentedModel

LATE = ("delay", "lag")
"""Effects on commands that MJCF can express."""
NOT_ALWAYS = "MJCF can only express effects that always act."
NOT_NAMED = "It is a closest match, which explains only part of the mismatch: its name is not certain."
NOT_TOGETHER = "It was fitted without the one before it: a model has one hidden state."
CURED = ("missing_physics", "parameters_only")
"""Verdicts with findings to write into the model."""


def account(
    engine: MujocoEngine,
    model: AugmentedModel,
    statement: Mapping[str, Any],
    file: str,
    recordings: Sequence[Recording],
) -> dict[str, Any]:
    """The statement with parameters in their units, notes on what of the model is left out, and the changes in `file`.

    engine: with the hidden state of the `model`, if it has one. If the stiffness of the model's servos was far off, the
    statement says so first; how far they sag and how late they follow it says last.
    """
    statement, start = _from_start(engine, statement), rescaling(engine)
    notes, written = [*filter(None, [start]), *engine.notes, *statement["notes"]], None
    found = servo_errors(engine, model.phi, _terms(engine, model), recordings)
    if start or statement["verdict"] in CURED:
        try:
            result = patched(engine, model, statement, Path())
            written = {
                "file": file,
                "changes": [asdict(c) for c in result.changes],
                "unwritten": list(result.unwritten),
            }
        except SimgapError as error:
            notes.append(f"The findings could not be written into the model: {error}")
    said = {**statement, "notes": notes, "parameters": _sizes(engine, statement["parameters"]), "patched": written,
            "servo_errors": [asdict(s) for s in found]}  # fmt: skip
    servos = words(found, engine.time_step) if said["verdict"] in CURED or start else ""
    # The words are about parameters, which have units now.
    renewed = bool(start) or said["verdict"] == "parameters_only"
    parts = [start, wording.statement(said) if renewed else said["statement"], servos, _in_open_loop(said)]
    return {**said, "statement": " ".join(filter(None, parts))}


def _in_open_loop(said: Mapping[str, Any]) -> str:
    """Errors in open loop of the model file and of what was found; empty if the search started at the file."""
    replay = said.get("replay") or {}
    positions = [p for p in replay.get("positions", []) if "given" in p["errors"]]
    if not positions:
        return ""
    found = "augmented" if "augmented" in positions[0]["errors"] else "refitted"
    simulator = {"augmented": "simulator with the effects", "refitted": "refitted simulator"}[found]
    each = [
        f"{p['name']} from {number(1000 * p['errors']['given'])} to {number(1000 * p['errors'][found])} m{p['unit']}"
        for p in positions
    ]
    return (
        f"In open loop over {number(replay['seconds'])} s of held-out sessions, errors of the model file and of the "
        f"{simulator}: {', '.join(each)}."
    )


def _terms(engine: MujocoEngine, model: AugmentedModel) -> Float[np.ndarray, " k"]:
    """The engine's terms in a model."""
    return np.asarray(terms_of(Augmented(cast(Engine, engine)), model.theta))


def _from_start(engine: MujocoEngine, statement: Mapping[str, Any]) -> dict[str, Any]:
    """The statement in terms of the model, also where the diagnosis started from another stiffness of its servos."""
    start = rescaling(engine)
    if not start:
        return dict(statement)
    # A model that needs nothing but the new stiffness still had parameters that were off.
    verdict = "parameters_only" if statement["verdict"] == "nothing" else statement["verdict"]
    return {**statement, "verdict": verdict, "warnings": [start, *statement["warnings"]]}


def patched(engine: MujocoEngine, model: AugmentedModel, statement: Mapping[str, Any], folder: Path) -> Patched:
    """The model with the fitted parameters and the named effects, for a file in `folder`.

    engine: with the hidden state of the `model`, if it has one. Left out, each with the reason: effects that MJCF
    cannot express, effects that do not always act, further hidden states, and closest matches, whose names are not
    certain. SimgapError where the model cannot be compiled.
    """
    own, late, unwritten = {(term.effect, term.form) for term in engine.terms}, {kind: {} for kind in LATE}, []
    for effect in statement["effects"]:
        always = effect["support"]["kind"] in ("always", "since_baseline")  # the model is of the machine as it is now
        if always and effect["id"] in late:
            (constant,) = effect["constants"]
            late[effect["id"]] |= {name.removeprefix("cmd_"): constant["value"] for name in effect["channels"]}
        elif effect["id"] in BEHIND_JOINTS:
            if not any(_is_of(term, effect, engine.terms) for term in engine.terms):
                unwritten.append(f"{effect['statement']} {NOT_TOGETHER}")
        elif not always or (effect["id"], effect["form"]) not in own:
            unwritten.append(f"{effect['statement']} {'MJCF cannot express it.' if always else NOT_ALWAYS}")
    unwritten += [f"{match['statement']} {NOT_NAMED}" for match in statement["closest_matches"]]
    terms = _terms(engine, model)
    named = [any(_is_of(term, e, engine.terms) for e in statement["effects"]) for term in engine.terms]
    written = patch(engine, model.phi, np.where(named, terms, 0.0), folder, late["delay"], late["lag"])
    return Patched(written.xml, written.changes, (*written.unwritten, *unwritten))


def _is_of(term: Term, effect: Mapping[str, Any], terms: Sequence[Term]) -> bool:
    """Whether a term belongs to an effect of a statement, which may act at several places that share a constant."""
    kind = effect["id"], effect["form"]
    alone = effect["where"] in [t.where for t in terms if (t.effect, t.form) == kind]
    here = term.where == effect["where"] if alone else set(term.outputs) <= set(effect["outputs"])
    return (term.effect, term.form) == kind and here


def _sizes(engine: MujocoEngine, statement: Mapping[str, Any]) -> dict[str, Any]:
    """A statement's parameters, which are logarithms of scales, as values with units; and each change in words."""
    set_by_model = {s.name: s.of for s in engine.scaled}  # also where the diagnosis started from other values

    def size(values: Mapping[str, Any]) -> dict[str, Any]:
        return {name: (set_by_model[name] * np.exp(value)).tolist() for name, value in values.items()}

    return {
        **statement,
        "nominal": set_by_model, **{part: size(statement[part]) for part in ("fitted", "ci95", "ranges")},
        "units": {s.name: s.unit for s in engine.scaled},
        "in_words": engine.words(np.array([statement["fitted"][s.name] for s in engine.scaled])),
    }  # fmt: skip
