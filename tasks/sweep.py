"""Stage-less `sweep`: its cells, its results, its best model."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from prefect import task
from pydantic import BaseModel

from simgap.formats.documents import read_json, write_table
from tasks import forms, report, score, train
from tasks.params import Params
from tasks.ranges import check_cells
from tasks.tracking.runs import Run, latest_run
from tasks.tracking.store import Store
from tasks.workspace import Cell, Workspace

REGISTERED = "dynamics"
"""The registered model whose versions are the sweeps' best ones, each with its sweep's name as alias."""
SHOWN = ("nll", "validation_nll", "calibration_error", "seconds")


class Row(NamedTuple):
    """A cell's scores and its run in MLflow."""

    workspace: Workspace
    cell: Cell
    scores: dict[str, Any]
    run_id: str

    @property
    def title(self) -> str:
        return self.cell.name + self.workspace.suffix


def cells(
    root: Path, source: str, hyperparameters: BaseModel, params: Callable[[dict[str, Any]], Params]
) -> dict[tuple[Workspace, Cell], Params]:
    """Every combination as a cell in a variant's workspace; a cell that a value does not concern is there once.
    ConfigError where they are too many.

    `params(overrides)`: the parameters with these changes.
    """
    found: dict[tuple[Workspace, Cell], Params] = {}
    for chosen in forms.variants(hyperparameters):
        own = params({"train": forms.nested(chosen)})
        for cell in train.grid(own.train):
            place = (Workspace(root, source, forms.label(chosen, hyperparameters, cell.method)), cell)
            found.setdefault(place, own)
        check_cells(len(found))
    return found


@task(task_run_name="write-{root.name}")
def write(root: Path, rows: Sequence[Row], params: Params, run: Run) -> None:
    """All scores as one table; tables, figures and claims of every variant; all of it beside the sweep's run."""
    everything = [{"variant": row.workspace.variant, **row.scores} for row in rows]
    write_table(root / "results.csv", everything)
    run.artifact(root / "results.csv")
    run.table("results", everything)
    for workspace in dict.fromkeys(row.workspace for row in rows):
        own = [row.scores for row in rows if row.workspace == workspace]
        report.write(workspace, own, params.train.noises, params.report.figure_dpi)
        for path in sorted(workspace.reports.glob("*.*")):
            run.artifact(path, f"report/{workspace.variant}".rstrip("/"))


@task(task_run_name="register-{name}", retries=1)
def register_best(rows: Sequence[Row], name: str, store: Store) -> Row:
    """The model with the lowest NLL on the test sessions, registered under the sweep's name; returns its row."""
    best = min(rows, key=_nll)
    run = Run(store, best.run_id)
    run.register(REGISTERED, [name, "newest"], {"cell": best.title, "nll": f"{best.scores['nll']:.4f}"})
    run.tags({"best_of": name})
    return best


def rows(workspace: Workspace, store: Store) -> list[Row]:
    """The rows that the stage `score` wrote, each with its model's latest run."""
    found = []
    for scores in score.load(workspace):
        cell = Cell(*(scores[name] for name in Cell._fields))
        mark = {"fingerprint": read_json(workspace.record(cell))["fingerprint"]}
        run = latest_run(store, mark)
        found.append(Row(workspace, cell, scores, run.run_id if run else ""))
    return found


def table(rows: Sequence[Row], link: Callable[[Row], str]) -> list[dict[str, Any]]:
    """The scores for people, best first, with where each run is."""
    return [
        {"model": row.title, **{k: round(row.scores[k], 4) for k in SHOWN}, "run": link(row)}
        for row in sorted(rows, key=_nll)
    ]


def _nll(row: Row) -> float:
    return row.scores["nll"] if math.isfinite(row.scores["nll"]) else math.inf
