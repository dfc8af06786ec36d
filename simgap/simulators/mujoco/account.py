"""What a diagnosis of a model found, in the model's terms: numbers as its XML has them, and the XML with them in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from simgap.diagnosis.report import wording
from simgap.effects.augmented import Augmented
from simgap.effects.stepping import terms_of
from simgap.engines import Engine, Term
from simgap.simulators.mujoco.engine import MujocoEngine
from simgap.simulators.mujoco.patch import Patched, patch
from simgap.simulators.mujoco.replay import rescaling
from simgap.types import SimgapError

if TYPE_CHECKING:
    from simgap.diagnosis.diagnose import AugmentedModel

LATE = ("delay", "lag")
"""Effects on commands that MJCF has words for."""
NOT_ALWAYS = "It does not act throughout, as what MJCF has words for does."
NOT_NAMED = "It is a closest match, which explains only part of the mismatch: its name is not certain."
CURED = ("missing_physics", "parameters_only")
"""Verdicts with something to write into the model."""


def account(engine: MujocoEngine, model: AugmentedModel, statement: Mapping[str, Any], file: str) -> dict[str, Any]:
    """The statement with parameters in their units, what of the model is left out, and what `file` has changed; before
    all else, whether the model's servos were wrong by far."""
    statement, start = _from_start(engine, statement), rescaling(engine)
    notes, written = [*filter(None, [start]), *engine.notes, *statement["notes"]], None
    if start or statement["verdict"] in CURED:
        try:
            found = patched(engine, model, statement, Path())
            written = {"file": file, "changes": [asdict(c) for c in found.changes], "unwritten": list(found.unwritten)}
        except SimgapError as error:
            notes.append(f"What was found could not be written into the model: {error}")
    parameters = _sizes(engine, statement["parameters"])
    return {**statement, "notes": notes, "parameters": parameters, "patched": written}


def _from_start(engine: MujocoEngine, statement: Mapping[str, Any]) -> dict[str, Any]:
    """The statement as one on the model, where the diagnosis started from another stiffness of its servos."""
    start = rescaling(engine)
    if not start:
        return dict(statement)
    # What needs no more than the new stiffness is still a model whose parameters were off.
    verdict = "parameters_only" if statement["verdict"] == "nothing" else statement["verdict"]
    statement = {**statement, "verdict": verdict, "warnings": [start, *statement["warnings"]]}
    return {**statement, "statement": f"{start} {wording.statement(statement)}"}


def patched(engine: MujocoEngine, model: AugmentedModel, statement: Mapping[str, Any], folder: Path) -> Patched:
    """The model with the parameters and the named effects that were found, for a file in `folder`.

    Not written, each with the reason: what MJCF has no word for, what does not act throughout, and closest matches,
    whose names are not certain. SimgapError where the model cannot be compiled.
    """
    own, late, unwritten = {term.effect for term in engine.terms}, {kind: {} for kind in LATE}, []
    for effect in statement["effects"]:
        always = effect["support"]["kind"] == "always"
        if always and effect["id"] in late:
            (constant,) = effect["constants"]
            late[effect["id"]] |= {name.removeprefix("cmd_"): constant["value"] for name in effect["channels"]}
        elif not always or effect["id"] not in own:
            unwritten.append(f"{effect['statement']} {'MJCF has no word for it.' if always else NOT_ALWAYS}")
    unwritten += [f"{match['statement']} {NOT_NAMED}" for match in statement["closest_matches"]]
    terms = np.asarray(terms_of(Augmented(cast(Engine, engine)), model.theta))
    named = [any(_is_of(term, e, engine.terms) for e in statement["effects"]) for term in engine.terms]
    written = patch(engine, model.phi, np.where(named, terms, 0.0), folder, late["delay"], late["lag"])
    return Patched(written.xml, written.changes, (*written.unwritten, *unwritten))


def _is_of(term: Term, effect: Mapping[str, Any], terms: Sequence[Term]) -> bool:
    """Whether a term is an effect of a statement, or of several places that share its constant."""
    alone = effect["where"] in [t.where for t in terms if t.effect == effect["id"]]
    here = term.where == effect["where"] if alone else set(term.outputs) <= set(effect["outputs"])
    return term.effect == effect["id"] and here


def _sizes(engine: MujocoEngine, statement: Mapping[str, Any]) -> dict[str, Any]:
    """A statement's parameters, which are logarithms of shares, as sizes with units; and each change in words."""
    of = {s.name: s.of for s in engine.scaled}  # what the model sets, wherever the diagnosis started

    def size(values: Mapping[str, Any]) -> dict[str, Any]:
        return {name: (of[name] * np.exp(value)).tolist() for name, value in values.items()}

    return {
        **statement,
        "nominal": of, **{part: size(statement[part]) for part in ("fitted", "ci95", "ranges")},
        "units": {s.name: s.unit for s in engine.scaled},
        "in_words": engine.words(np.array([statement["fitted"][s.name] for s in engine.scaled])),
    }  # fmt: skip
