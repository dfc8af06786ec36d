"""A sweep: models, N, seeds and hyperparameters of one's choice, on recordings of one's choice; in `sweeps/<name>/`."""

from flows.start_sweep import main

if __name__ == "__main__":
    main()  # before the imports, which take seconds

import time
from pathlib import Path
from typing import Any

from prefect.utilities.names import generate_slug

from flows import provenance, transitions
from flows import recordings as recordings_flow
from flows.fan_out import Place
from flows.flow import flow
from flows.locks import alone
from flows.start import PARAMS
from flows.train import failures, train_cells
from simgap.cli import progress
from simgap.formats.documents import write_json
from simgap.types import SimgapError
from tasks import artifacts, forms, score, sweep
from tasks.forms import Hyperparameters, Models, Noises, Recordings, RunName, SampleSizes, Seeds
from tasks.params import Params, load_params
from tasks.tracking import links
from tasks.tracking.runs import Run, grid_run
from tasks.tracking.store import Store
from tasks.workspace import Workspace


@flow(name="sweep", flow_run_name="{name}")
def run(
    name: RunName,
    recordings: Recordings,
    models: Models,
    noises: Noises,
    sample_sizes: SampleSizes,
    seeds: Seeds,
    hyperparameters: Hyperparameters = Hyperparameters(),  # type: ignore[valid-type]  # noqa: B008
) -> None:
    """Train and score every combination; the best is registered in MLflow.

    Args:
        name: The run's name, here and in MLflow, and its folder in sweeps/; letters, digits, dashes and underscores. A
            name that exists goes on where it stopped.
        recordings: What to learn from, and what to judge by.
        models: How to learn.
        noises: Families of the learned likelihood.
        sample_sizes: N, transitions to learn from.
        seeds: Each draws other transitions, networks and simulators.
        hyperparameters: Values to try, block by block; every combination is trained.
    """
    root = forms.folder(name)
    grid = {"models": models, "noises": noises, "sample_sizes": sample_sizes, "seeds": seeds}
    base = [recordings.overrides(load_params(PARAMS)), {"train": grid}]
    params = load_params(PARAMS, *base)
    forms.check_source(params, recordings.source)
    cells = sweep.cells(root, recordings.source, hyperparameters, lambda more: load_params(PARAMS, *base, more))
    with alone(root, recordings.source):
        write_json(root / "sweep.json", {"recordings": recordings.model_dump(), **grid,
                                               "hyperparameters": hyperparameters.model_dump()})  # fmt: skip
        prepare(recordings.source, params, root)
        _train_and_score(name, root, cells, params)


def prepare(source: str, params: Params, root: Path) -> None:
    """Recordings and transitions, in the run's own folder."""
    recordings_flow.run(source, params, root)
    transitions.run(source, params, root)


def _train_and_score(name: str, root: Path, cells: dict[Place, Params], params: Params) -> None:
    workspace = next(iter(cells))[0]
    shared = Workspace(root, workspace.source)
    store = provenance.store()
    tags = {**provenance.tags(shared, shared.transitions), "sweep": name}
    with grid_run(store, f"sweep-{name}", params.train.model_dump(), tags) as parent:
        progress.say(f"MLflow: {links.to_run(store, parent.run_id)}")
        failed = train_cells(cells, tags, parent)
        rows = _score({place: p for place, p in cells.items() if place not in failed}, parent)
        if rows:
            sweep.write(root, rows, params, parent)
            best = sweep.register_best(rows, name, store)
            _show(name, rows, best, store, parent)
        if failed:
            raise SimgapError(failures(failed, len(cells)))


def _score(cells: dict[Place, Params], parent: Run) -> list[sweep.Row]:
    rows = []
    if not cells:
        return rows
    (workspace, _), params = next(iter(cells.items()))
    test = score.load_test(workspace, 1 / params.transitions.nominal_rate_hz)
    with progress.bars(f"score on {workspace.source}", len(cells), time.monotonic) as bars:
        for (workspace, cell), own in cells.items():
            with bars.job(cell.name + workspace.suffix, 1):
                scored = score.score_cell(workspace, cell, test, own.score)
                logged = score.log_scores(workspace, cell, scored, parent.store, parent.run_id)
                rows.append(sweep.Row(workspace, cell, scored, logged.run_id if logged else ""))
    return rows


def _show(name: str, rows: list[sweep.Row], best: sweep.Row, store: Store, parent: Run) -> None:
    """The results as a table and links in Prefect's pages and in the terminal."""
    linked = sweep.table(rows, lambda row: f"[MLflow]({links.to_run(store, row.run_id)})")
    artifacts.table("sweep-results", linked, f"Sweep {name}, best first. Best: {best.title}.")
    places = {"MLflow": links.to_run(store, parent.run_id),
              "compare": links.to_comparison(store, name, f"tags.sweep = '{name}'", links.MODEL_RESULTS),
              "folder": str(forms.folder(name))}  # fmt: skip
    artifacts.links("sweep-links", places, f"Sweep {name}")
    progress.table(f"sweep {name}", sweep.table(rows, lambda row: row.run_id))
    progress.say("\n".join(f"{what:8}{place}" for what, place in places.items() if place))
    progress.say(f"{'best':8}models:/{sweep.REGISTERED}@{name}   ({best.title})")


def start(name: str, arguments: dict[str, Any]) -> None:
    """A sweep in this process, under a name of one's own or one that is made up."""
    run(name=name or generate_slug(2), **arguments)
