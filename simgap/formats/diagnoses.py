"""Writes the files of a diagnosis to its folder, and loads its simulator from there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from jaxtyping import Float

from simgap.effects.effect import Scales
from simgap.effects.regime import Acting
from simgap.engines import Behind, Engine, split_as
from simgap.formats import statements
from simgap.formats.arrays import load_arrays, save_arrays
from simgap.formats.documents import write_json, write_table, write_text
from simgap.formats.effects import pop_acting, pop_scales, scale_arrays
from simgap.formats.folders import remove_file
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.refitted import refitted
from simgap.simulators.spot import Spot
from simgap.types import Schema, SimgapError, StepModel

if TYPE_CHECKING:  # whoever loads a simulator diagnoses nothing
    from simgap.diagnosis.diagnose import AugmentedModel, Diagnosis

STATEMENT, PAGE, EXPERIMENT, MODEL = "diagnosis.json", "diagnosis.html", "experiment.csv", "augmented.npz"
"""The files; the experiment only where one is proposed."""
PATCHED = ".patched.xml"
"""Suffix of a model file that a diagnosis wrote."""


def write(
    folder: Path, found: Diagnosis, page: str, schema: Schema, models: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Write the statement, the page, the constants of the simulator with effects, the experiment if there is one, and
    `models`: texts of model files by their names, which end in `PATCHED`.

    The statement is deleted first and written last: if it exists, all other files are of the same diagnosis.
    """
    for path in (*(folder / name for name in (STATEMENT, PAGE, EXPERIMENT, MODEL)), *folder.glob(f"*{PATCHED}")):
        remove_file(path, folder)
    save_arrays(folder / MODEL, _arrays(found.model))
    if found.experiment is not None:
        write_experiment(folder / EXPERIMENT, found.experiment, schema)
    for name, text in models.items():
        write_text(folder / name, text)
    write_text(folder / PAGE, page)
    write_json(folder / STATEMENT, found.statement)


def write_experiment(
    path: Path, experiment: tuple[Float[np.ndarray, " T"], Float[np.ndarray, "T u"]], schema: Schema
) -> None:
    """Times [s] and commands of an experiment, as a table."""
    columns = ("time_s", *(f.name for f in schema.command))
    rows = np.column_stack(experiment)
    write_table(path, [dict(zip(columns, row, strict=True)) for row in rows])


def read_statement(folder: Path) -> dict[str, Any]:
    """The statement in `diagnosis.json`; SimgapError where the folder has no diagnosis."""
    if not (folder / STATEMENT).is_file():
        raise SimgapError(f"{folder}: holds no {STATEMENT}. Give the folder that `simgap diagnose` wrote to.")
    return statements.read(folder / STATEMENT)


def read_simulator(path: Path, simulator: StepModel | Engine) -> AugmentedSimulator:
    """The simulator with the effects and the fitted parameters in `path`, the `augmented.npz` of a diagnosis of it.

    Raises SimgapError where the file is damaged, or is of another simulator.
    """
    arrays = load_arrays(path)
    try:
        scales, acting, phi = pop_scales(arrays), pop_acting(arrays), arrays["phi"]
        behind = tuple(map(str, arrays.get("behind", ())))  # versions before had none
        if isinstance(simulator, Spot):  # whose time step is the recordings'
            simulator = replace(simulator, time_step=scales.time_step)
        return corrected(with_hidden(simulator, behind), phi, acting, scales)
    except (KeyError, ValueError) as error:
        raise SimgapError(
            f"{path}: is no diagnosis of this simulator by this version ({error}). Diagnose again."
        ) from None


def with_hidden(simulator: StepModel | Engine, behind: Sequence[str]) -> StepModel | Engine:
    """The simulator with the hidden state that a diagnosis named, if it named one (see `AugmentedModel`); ValueError
    where it cannot have it."""
    return split_as(cast(Engine, simulator), Behind(*behind)) if behind else simulator


def corrected(
    simulator: StepModel | Engine, phi: Float[np.ndarray, " p"], acting: Acting, scales: Scales
) -> AugmentedSimulator:
    """A simulator with effects and fitted parameters; ValueError where their numbers differ from the simulator's."""
    if len(phi) != len(simulator.parameters):
        raise ValueError(f"it has {len(phi)} parameters, the simulator {len(simulator.parameters)}")
    fitted: Any = refitted(simulator, phi.tolist())  # a Simulator where the other is one
    return AugmentedSimulator.of(fitted, acting, scales)


def _arrays(model: AugmentedModel) -> dict[str, np.ndarray]:
    constants = model._asdict()
    scales = scale_arrays(constants.pop("scales"))
    return {name: np.asarray(array) for name, array in constants.items()} | scales
