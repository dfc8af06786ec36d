"""Stage `score`: every model of the grid on the test sessions."""

import math
from typing import Any

from prefect import task

from simgap import scores
from simgap.formats.documents import read_json, write_json
from simgap.formats.recordings import read_recordings
from simgap.simulators.spot import SCHEMA
from simgap.types import Recording, Transitions
from tasks import transitions
from tasks.files.models import load_model
from tasks.params import ScoreParams
from tasks.tracking.runs import Run, latest_run
from tasks.tracking.store import Store
from tasks.workspace import Cell, Workspace

TABLE = "scores.json"


@task(task_run_name="load-test-sessions-{workspace.source}")
def load_test(workspace: Workspace, time_step: float) -> tuple[Transitions, list[Recording]]:
    """The test sessions' transitions, and the sessions themselves for rollouts."""
    recordings, errors = read_recordings(workspace.recordings / "test", SCHEMA, time_step)
    if errors:
        raise errors[0]
    return transitions.load(workspace, "test"), recordings


@task(task_run_name="score-{cell.name}{workspace.suffix}")
def score_cell(
    workspace: Workspace, cell: Cell, test: tuple[Transitions, list[Recording]], params: ScoreParams
) -> dict[str, Any]:
    """The cell's scores, with what identifies it, the effects it was given and how long it trained."""
    rows, recordings = test
    model = load_model(workspace.model(cell))
    record = read_json(workspace.record(cell))
    return {
        **cell._asdict(),
        **({"effects": ", ".join(record["effects"])} if "effects" in record else {}),
        "seconds": record["seconds"],
        "steps": record["steps"],
        # Kept by early stopping, within the N: what one may choose by. SIM-MODEL keeps no rows for validation.
        "validation_nll": min(record["curve"].get("validation_nll", [math.nan])),
        **scores.one_step(model, rows, SCHEMA.encoded),
        **scores.multi_step(model, SCHEMA, recordings, tuple(params.horizons), params.stride),
    }


@task(task_run_name="log-scores-{cell.name}{workspace.suffix}", retries=1)
def log_scores(
    workspace: Workspace, cell: Cell, row: dict[str, Any], store: Store, parent_run_id: str | None = None
) -> Run | None:
    """Add the scores to the cell's latest run in MLflow, of that parent where it is given; returns the run.

    A model from DVC's cache may have none in this store.
    """
    mark = {"fingerprint": read_json(workspace.record(cell))["fingerprint"]}
    run = latest_run(store, mark, parent_run_id)
    if run:
        run.scores({name: value for name, value in row.items() if name not in (*cell._fields, "effects")})
    return run


@task(task_run_name="write-scores-{workspace.source}")
def write(workspace: Workspace, rows: list[dict[str, Any]]) -> None:
    """One row a cell."""
    write_json(workspace.scores / TABLE, {"cells": rows})


def load(workspace: Workspace) -> list[dict[str, Any]]:
    """The rows that `write` wrote; a score that is not finite is NaN."""
    rows = read_json(workspace.scores / TABLE)["cells"]
    return [{name: math.nan if value is None else value for name, value in row.items()} for row in rows]
