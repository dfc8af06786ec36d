"""Stage `train`: one model of the grid, fitted to N transitions drawn with a seed."""

import ast
import hashlib
import importlib.util
import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from prefect import task

from simgap import fsvgd, identify, priors
from simgap.domain import uniform_inputs
from simgap.models import FittedSpot, Model
from simgap.noise import FAMILIES
from simgap.recordings import draw, normalisation
from simgap.simulators import normalised_functions, sample_parameters
from simgap.simulators.spot import Spot
from simgap.types import ConfigError, Report, SimgapError, Transitions
from tasks import files, transitions
from tasks.params import Params, TrainParams
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


def fit(cell: Cell, data: Transitions, time_step: float, params: TrainParams, report: Report) -> Model:
    """The cell's model; the N transitions depend on seed and N alone, so that all models learn from the same draw.

    Raises ConfigError when fewer than N transitions are there, DivergenceError when training leaves the finite numbers.
    """
    if cell.sample_size > len(data.x):
        raise ConfigError(
            f"N = {cell.sample_size} transitions are asked for and the training sessions have {len(data.x)}. "
            "Lower train.sample_sizes, or add sessions."
        )
    key_draw, key_train, key_phi = jax.random.split(jax.random.key(cell.seed), 3)
    rows = draw(key_draw, cell.sample_size, len(data.x))
    x, y = jnp.asarray(data.x)[rows], jnp.asarray(data.y)[rows]
    noise, spot = FAMILIES[cell.noise], Spot(time_step=time_step)
    if cell.model == "sim_model":
        fitted, scale, dof = identify.identify(spot, (x, y), params.sim_model, noise, report)
        return FittedSpot(fitted, scale, dof, jnp.asarray(time_step))

    n_validation = max(1, round(params.validation_share * cell.sample_size))
    validation, training = (x[:n_validation], y[:n_validation]), (x[n_validation:], y[n_validation:])
    stats = normalisation(*training)

    if cell.model == "fsvgd":
        prior = params.fsvgd
        marginals = priors.gp_marginals(y.shape[1], prior.lengthscale, prior.outputscale)
    else:
        prior = params.sim_fsvgd
        functions = normalised_functions(spot, sample_parameters(spot, key_phi, prior.function_samples), stats)
        marginals = priors.simulator_marginals(functions, prior.lengthscale, prior.outputscale)
    points_per_epoch = params.bnn.measurement_sets * prior.measurement_points
    key_points, key_train = jax.random.split(key_train)
    points = uniform_inputs(key_points, points_per_epoch, training[0], spot)
    sets = points.reshape(params.bnn.measurement_sets, prior.measurement_points, -1)
    return fsvgd.train(key_train, (training, validation), stats, sets, marginals, params.bnn, noise, report)


def fingerprint(cell: Cell, data_digest: str, time_step: float, params: TrainParams) -> str:
    """Identifies what a cell's result depends on: the data, its share of the parameters, and the code of `simgap`.

    Code counts without comments and docstrings, so that rewording one does not make finished cells stale.
    """
    relevant = {
        "cell": cell,
        "data": data_digest,
        "time_step": time_step,
        "params": asdict(params.sim_model) if cell.model == "sim_model" else {
            "bnn": asdict(params.bnn),
            "prior": (params.fsvgd if cell.model == "fsvgd" else params.sim_fsvgd).model_dump(),
            "validation_share": params.validation_share,
        },
        "code": _code_digest(("simgap.domain", "simgap.fsvgd", "simgap.identify", "simgap.simulators.spot")),
    }
    return hashlib.sha256(json.dumps(relevant, sort_keys=True).encode()).hexdigest()[:16]


def _code_digest(roots: Sequence[str]) -> str:
    """Digest of modules of `simgap` and all that they import from it, comments and docstrings apart."""
    sources: dict[str, str] = {}
    queue = list(roots)
    while queue:
        name = queue.pop()
        spec = importlib.util.find_spec(name) if name.split(".")[0] == "simgap" else None
        if name in sources or spec is None or spec.origin is None:
            continue
        tree = ast.parse(Path(spec.origin).read_text())
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                queue += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            body = getattr(node, "body", None)
            if isinstance(body, list):
                node.body = [s for s in body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]  # type: ignore[attr-defined]
        sources[name] = ast.dump(tree)
    return hashlib.sha256(json.dumps(sources, sort_keys=True).encode()).hexdigest()


def finished(workspace: Workspace, cell: Cell, fingerprint: str) -> bool:
    """Whether the cell was trained before on the same data, parameters and code."""
    record = workspace.record(cell)
    return (
        workspace.model(cell).exists() and record.exists() and files.read_json(record).get("fingerprint") == fingerprint
    )


Job = Callable[[str, int], AbstractContextManager[Report]]
"""`job(name, steps)`: a piece of work of at most so many steps begins; gives its `report`."""


def steps_at_most(cell: Cell, params: TrainParams) -> int:
    """Training steps of a cell, if it does not stop early."""
    if cell.model == "sim_model":
        return params.sim_model.training_steps
    return params.bnn.training_steps(cell.sample_size)


def _may_pass(_task: Any, _run: Any, state: Any) -> bool:
    """Whether a failure may pass by itself: what the project explains as wrong input or divergence does not."""
    return not isinstance(state.result(raise_on_failure=False), SimgapError)


@task(task_run_name="{cell.noise}/{cell.name}", retries=1, retry_condition_fn=_may_pass)
def train_cell(
    workspace: Workspace, cell: Cell, params: Params, job: Job, clock: Callable[[], float]
) -> dict[str, Any]:
    """Train one cell, unless it was finished before, and write its model and its record; returns the record.

    The record is written last: a run killed halfway leaves no record, and the cell is trained again. `job(name, steps)`
    gives a context with the `report` of progress; `clock` gives seconds.
    """
    time_step = 1 / params.transitions.nominal_rate_hz
    mark = fingerprint(cell, transitions.digest(workspace), time_step, params.train)
    if finished(workspace, cell, mark):
        return files.read_json(workspace.record(cell))
    curve: dict[str, list[float]] = {"step": []}

    def keep(step: int, metrics: dict[str, float]) -> None:
        curve["step"].append(step)
        for name, value in metrics.items():
            curve.setdefault(name, []).append(value)
        report(step, metrics)

    start = clock()
    with job(f"{cell.noise}/{cell.name}", steps_at_most(cell, params.train)) as report:
        model = fit(cell, transitions.load(workspace, "training"), time_step, params.train, keep)
    record = {
        **cell._asdict(),
        "fingerprint": mark,
        "seconds": clock() - start,
        "steps": curve["step"][-1],
        "curve": curve,
    }
    files.save_model(workspace.model(cell), model)
    files.write_json(workspace.record(cell), record)
    return record


def remove_stale(workspace: Workspace, cells: Sequence[Cell]) -> None:
    """Delete models and records of cells that the grid no longer has: a stage's output holds this grid alone."""
    wanted = {path for cell in cells for path in (workspace.model(cell), workspace.record(cell))}
    for path in workspace.models.rglob("*"):
        if path.is_file() and path not in wanted:
            path.unlink()
