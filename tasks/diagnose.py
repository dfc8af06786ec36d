"""Stage `diagnose`: what a simulator leaves out, found in recordings, written for people and for programs."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from prefect import task

from simgap.diagnosis.diagnose import Diagnosis, diagnose
from simgap.engines import Engine
from simgap.formats import diagnoses, purposes
from simgap.formats.diagnoses import EXPERIMENT, MODEL, PAGE, STATEMENT
from simgap.formats.purposes import Folders
from simgap.formats.recordings import digest
from simgap.page.diagnosis import page
from simgap.types import Schema, Sessions, StepModel
from tasks import fingerprint
from tasks.tracking.models import log_simulator
from tasks.tracking.runs import Run


@task(task_run_name="read-{folders.recordings.name}")
def read(folders: Folders, simulator: StepModel | Engine) -> tuple[Sessions, list[str]]:
    """The sessions by their purpose, and what was wrong with those left out.

    Raises RecordingError as `purposes.read` and `purposes.arranged` do.
    """
    given, errors = purposes.read(folders, simulator)
    return purposes.arranged(simulator, given), errors


@task(task_run_name="diagnose-{name}")
def find(
    simulator: StepModel | Engine, name: str, sessions: Sessions, seed: int, say: Callable[[str], None]
) -> Diagnosis:
    """What the simulator called `name` leaves out; `say(line)` tells what is being tried."""
    return diagnose(simulator, name, sessions, seed, say)


@task(task_run_name="write-{folder.name}")
def write(folder: Path, found: Diagnosis, schema: Schema) -> None:
    """Statement, page, constants and experiment, as `simgap diagnose` leaves them."""
    diagnoses.write(folder, found, page(found.statement, found.evidence), schema)


@task(task_run_name="log-recordings-{name}", retries=1)
def log_recordings(run: Run, name: str, folders: Folders, sessions: Sessions, seed: int) -> None:
    """What is diagnosed, before it is: a run that fails says as much."""
    places = [folders.recordings, folders.heldout, folders.baseline]
    run.tags({"config": fingerprint.configuration_of_diagnosis(name, places, seed)})
    run.params(
        {
            "simulator": name,
            "recordings": folders.recordings,
            "baseline": folders.baseline or "none",
            "seed": seed,
            "transitions": sum(len(r.time_s) - 1 for r in sessions.training),
            "sessions": {purpose: len(recordings) for purpose, recordings in sessions.by_purpose.items()},
        }
    )
    for purpose, recordings in sessions.by_purpose.items():
        if recordings:
            folder = getattr(folders, purpose, None) or folders.recordings
            run.dataset(f"{folder.resolve().name}-{purpose}", folder, digest(recordings), purpose)


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
