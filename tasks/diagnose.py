"""Stage `diagnose`: what a simulator leaves out, found in recordings, written for people and for programs."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from prefect import task

from simgap.derived import derived, sentence
from simgap.diagnosis.diagnose import Diagnosis, diagnose
from simgap.diagnosis.inference.explain import split
from simgap.types import Recording, RecordingError, Schema, Sessions, StepModel
from tasks import fingerprint
from tasks.diagnosis_page import page
from tasks.files.arrays import save_arrays
from tasks.files.documents import write_json, write_table, write_text
from tasks.files.effects import scale_arrays
from tasks.files.folders import remove_file
from tasks.files.recordings import read_recordings
from tasks.tracking.models import log_simulator
from tasks.tracking.runs import Run

STATEMENT, PAGE, EXPERIMENT, MODEL = "diagnosis.json", "diagnosis.html", "experiment.csv", "augmented.npz"
"""What a diagnosis leaves in its folder; the experiment only where there is one to make."""


class Folders(NamedTuple):
    """Recordings to diagnose; sessions to judge by and sessions from when all was well, where they lie apart."""

    recordings: Path
    heldout: Path | None = None
    baseline: Path | None = None


@task(task_run_name="read-{folders.recordings.name}")
def read(folders: Folders, simulator: StepModel) -> tuple[Sessions, list[str]]:
    """The sessions, and what was wrong with those left out; without a folder held out, some sessions are.

    Raises RecordingError when a folder has no usable session, when one of its velocities is a difference of its
    position, or when a session serves two purposes.
    """
    errors: list[str] = []

    def sessions(folder: Path | None) -> list[Recording]:
        if folder is None:
            return []
        found, bad = read_recordings(folder, simulator.schema, simulator.time_step)
        errors.extend(str(error) for error in bad)
        if differences := derived(simulator.schema, found):
            raise RecordingError("\n".join(f"{folder}: column {sentence(d)}" for d in differences))
        return found

    given = sessions(folders.recordings)
    training, heldout = (given, sessions(folders.heldout)) if folders.heldout else split(given)
    heldout = _apart(heldout, training, folders.heldout)
    baseline = _apart(sessions(folders.baseline), [*training, *heldout], folders.baseline)
    return Sessions(training, heldout, baseline), errors


def _apart(recordings: list[Recording], others: Sequence[Recording], folder: Path | None) -> list[Recording]:
    """Sessions that are none of the others; where names coincide, those of `folder` take its name before theirs."""
    if folder is None:
        return recordings
    seen = {fingerprint.of_recordings([r]): r.name for r in others}
    for r in recordings:
        if same := seen.get(fingerprint.of_recordings([r])):
            raise RecordingError(
                f"{folder}: the session {r.name} is the session {same} of another folder; a session must serve one "
                "purpose: to be diagnosed, to judge by, or as baseline. Put it in one of the folders only."
            )
    if {r.name for r in recordings} & {r.name for r in others}:
        return [r._replace(name=f"{folder.resolve().name}/{r.name}") for r in recordings]
    return recordings


@task(task_run_name="diagnose-{name}")
def find(simulator: StepModel, name: str, sessions: Sessions, seed: int, say: Callable[[str], None]) -> Diagnosis:
    """What the simulator called `name` leaves out; `say(line)` tells what is being tried."""
    return diagnose(simulator, name, sessions, seed, say)


@task(task_run_name="write-{folder.name}")
def write(folder: Path, found: Diagnosis, schema: Schema) -> None:
    """Statement, page, the simulator's constants with the effects in it, and the experiment if one is called for.

    The statement goes first and comes last: where it is, all else is of the same diagnosis.
    """
    for name in (STATEMENT, PAGE, EXPERIMENT, MODEL):
        remove_file(folder / name, folder)
    constants = found.model._asdict()
    scales = scale_arrays(constants.pop("scales"))
    save_arrays(folder / MODEL, {name: np.asarray(array) for name, array in constants.items()} | scales)
    if found.experiment is not None:
        columns = ("time_s", *(f.name for f in schema.command))
        rows = np.column_stack(found.experiment)
        write_table(folder / EXPERIMENT, [dict(zip(columns, row, strict=True)) for row in rows])
    write_text(folder / PAGE, page(found.statement, found.evidence))
    write_json(folder / STATEMENT, found.statement)


@task(task_run_name="log-recordings-{name}", retries=1)
def log_recordings(run: Run, name: str, folders: Folders, sessions: Sessions, seed: int) -> None:
    """What is diagnosed, before it is: a run that fails says as much."""
    run.tags({"config": fingerprint.configuration_of_diagnosis(name, folders, seed)})
    run.params(
        {
            "simulator": name,
            "recordings": folders.recordings,
            "baseline": folders.baseline or "none",
            "seed": seed,
            "transitions": sum(len(r.time_s) - 1 for r in sessions.training),
            "sessions": {purpose: len(recordings) for purpose, recordings in sessions._asdict().items()},
        }
    )
    for purpose, recordings in sessions._asdict().items():
        if recordings:
            folder = getattr(folders, purpose, None) or folders.recordings
            run.dataset(f"{folder.resolve().name}-{purpose}", folder, fingerprint.of_recordings(recordings), purpose)


@task(task_run_name="log-{folder.name}", retries=1)
def log(run: Run, folder: Path, found: Diagnosis, schema: Schema, seconds: float) -> None:
    """Verdict, effects, held-out scores, the augmented simulator as a model; and the files that `write` wrote."""
    statement = found.statement
    effects = [effect["id"] for effect in statement["effects"]]
    run.tags({"verdict": statement["verdict"], "effects": ", ".join(effects) or "none"})
    run.describe(statement["statement"])
    run.scores({**dict(scores(statement)), "effects": len(effects), "seconds": seconds})
    for name in (STATEMENT, PAGE, EXPERIMENT, MODEL):
        if (folder / name).exists():
            run.artifact(folder / name)
    log_simulator(run, folder / MODEL, statement["simulator"], schema)


def scores(statement: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Held-out scores as `<model>/<score>`, and the share that the named effects explain; what is unknown is absent."""
    fit = statement["fit"]
    found = {
        # MLflow's names admit no brackets: the unit stays in diagnosis.json.
        f"{model}/{score.partition(' [')[0]}": entry["value"]
        for model, table in fit["models"].items()
        for score, entry in table.items()
    }
    for name, value in {**found, "explained_share": fit.get("explained_share")}.items():
        if value is not None and not math.isnan(value):
            yield name, value
