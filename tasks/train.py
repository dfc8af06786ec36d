"""Stage `train`: one model of the grid, fitted to N transitions drawn with a seed."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import NamedTuple

import jax
import jax.numpy as jnp
from prefect import task

from simgap import learn
from simgap.formats.documents import read_json, write_json
from simgap.formats.folders import remove_file
from simgap.noise import FAMILIES
from simgap.prediction import Model
from simgap.recordings import draw
from simgap.residual.learn import residual_model
from simgap.simulators import sample_parameters
from simgap.simulators.spot import Spot
from simgap.types import ConfigError, Recording, Report, Simulator, Transitions
from tasks import diagnosed, transitions
from tasks.cells import Curve, finished, may_pass
from tasks.files.models import save_model
from tasks.fingerprint import Codes, configuration, fingerprint, relevant_params
from tasks.params import Params, TrainParams
from tasks.tracking.models import log_model
from tasks.tracking.runs import Run, cell_run
from tasks.workspace import Cell, Workspace


def grid(params: TrainParams) -> list[Cell]:
    """Every cell: largest N first, so that no long cell is left running alone at the end."""
    return [
        Cell(noise, model, n, seed)
        for n in sorted(params.sample_sizes, reverse=True)
        for noise in params.noises
        for model in params.models
        for seed in params.seeds
    ]


def fit(
    cell: Cell,
    data: Transitions,
    simulator: Simulator,
    params: TrainParams,
    report: Report,
    sessions: Sequence[Recording] = (),
) -> Model:
    """The cell's model; the N transitions depend on seed and N alone, so that all models learn from the same draw.

    `sessions`: those of the cell's diagnosis, which say how a residual model predicts over many rows.

    Raises ConfigError when fewer than N transitions are there, DivergenceError when training leaves the finite numbers.
    """
    if cell.sample_size > len(data.x):
        raise ConfigError(
            f"N = {cell.sample_size} transitions are asked for and the training sessions have {len(data.x)}. "
            "Lower train.sample_sizes, or add sessions."
        )
    key_draw, key, key_phi = jax.random.split(jax.random.key(cell.seed), 3)
    rows = draw(key_draw, cell.sample_size, len(data.x))
    drawn = (jnp.asarray(data.x)[rows], jnp.asarray(data.y)[rows])
    noise = FAMILIES[cell.noise]
    match cell.method:
        case "sim_model":
            return learn.sim_model(drawn, simulator, params.sim_model, noise, report)
        case "fsvgd":
            return learn.fsvgd_model(key, drawn, simulator, params.fsvgd, params.bnn, noise, report)
        case "sim_fsvgd":
            phi = sample_parameters(simulator, key_phi, params.sim_fsvgd.function_samples)
            return learn.sim_fsvgd_model(key, drawn, simulator, phi, params.sim_fsvgd, params.bnn, noise, report)
        case "residual":
            own = Transitions(*drawn, jnp.asarray(data.session)[rows])
            return residual_model(key, own, sessions, simulator, (params.residual, params.bnn, noise), report)
        case unknown:
            raise ConfigError(f"there is no model {unknown}; there are sim_model, fsvgd, sim_fsvgd and residual.")


class Grid(NamedTuple):
    """What the cells share: the run of the whole grid in MLflow, its tags, the digests of the code."""

    run: Run
    tags: dict[str, str]
    codes: Codes


Job = Callable[[str, int], AbstractContextManager[Report]]
"""`job(name, steps)`: a piece of work of at most so many steps begins; gives its `report`."""


def steps_at_most(cell: Cell, params: TrainParams) -> int:
    """Training steps of a cell, if it does not stop early."""
    if cell.method == "sim_model":
        return params.sim_model.training_steps
    if cell.method == "residual":
        return params.residual.all_steps
    return params.bnn.training_steps(cell.sample_size)


@task(task_run_name="{cell.name}{workspace.suffix}", retries=1, retry_condition_fn=may_pass)
def train_cell(
    workspace: Workspace, cell: Cell, params: Params, grid: Grid, job: Job, clock: Callable[[], float]
) -> None:
    """Train one cell, unless it was finished before; write its model and its record, and log them.

    `job(name, steps)` gives a context with the `report` of progress; `clock` gives seconds.
    """
    digest, time_step = transitions.digest(workspace), 1 / params.transitions.nominal_rate_hz
    found = diagnosed.load(workspace, cell.share) if cell.share else None
    code = grid.codes.of(cell)
    mark = fingerprint(cell, digest, time_step, params.train, code, found.fingerprint if found else None)
    with job(cell.name + workspace.suffix, steps_at_most(cell, params.train)) as report:
        reused = finished(workspace.model(cell), workspace.record(cell), mark)
        if not reused:
            # Should this training fail, the model of other parameters must not pass for its result.
            remove_file(workspace.record(cell), workspace.root)
            simulator = found.simulator if found else Spot(time_step=time_step)
            keep, start = Curve(report, {}), clock()
            sessions = diagnosed.seen(workspace, cell.share, time_step) if cell.share else []
            model = fit(cell, transitions.load(workspace, "training"), simulator, params.train, keep, sessions)
            known = {"fingerprint": mark, **({"effects": list(found.simulator.effects)} if found else {})}
            training = {"seconds": clock() - start, "steps": keep.curve["step"][-1], "curve": keep.curve}
            # The record comes last: a cell killed halfway has none and is trained again.
            save_model(workspace.model(cell), model)
            write_json(workspace.record(cell), {**cell._asdict(), **known, **training})
    log_cell(workspace, cell, params.train, grid, {"transitions": digest, "reused": str(reused)})


def log_cell(workspace: Workspace, cell: Cell, params: TrainParams, grid: Grid, tags: dict[str, str]) -> Run:
    """A finished cell as a run of the grid's: parameters, effects, curve, data set with its digest, model."""
    record = read_json(workspace.record(cell))
    tags = {**grid.tags, **tags, "fingerprint": record["fingerprint"], "config": configuration(cell, params)}
    if cell.share:
        tags |= {"diagnosis": cell.share.name, "effects": ", ".join(record["effects"]) or "none"}
    with cell_run(grid.run.store, grid.run.run_id, cell.name + workspace.suffix, tags) as run:
        run.params({**cell._asdict(), **relevant_params(cell, params)})
        curve = dict(record["curve"])
        run.curve([int(step) for step in curve.pop("step")], curve)
        run.dataset(f"{workspace.source}-transitions", workspace.transitions, tags["transitions"], "training")
        run.scores({"training_seconds": record["seconds"], "steps": record["steps"]})
        log_model(run, workspace.model(cell))
    return run


def remove_stale(workspace: Workspace, cells: Sequence[Cell]) -> None:
    """Delete models and records of cells that the grid no longer has: a stage's output holds this grid alone."""
    wanted = {path for cell in cells for path in (workspace.model(cell), workspace.record(cell))}
    wanted |= {path for s in diagnosed.shares(cells) for path in (workspace.augmented(s), workspace.effects(s))}
    for path in workspace.models.rglob("*"):
        if path.is_file() and path not in wanted:
            remove_file(path, workspace.root)
