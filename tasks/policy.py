"""Stage `policy`: one policy a model of the grid, learnt inside it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
from prefect import task

from simgap import models
from simgap.formats.arrays import load_arrays, save_arrays
from simgap.formats.documents import read_json, write_json
from simgap.formats.folders import remove_file
from simgap.policies import learn
from simgap.policies.actor import Actor
from simgap.policies.environment import LearntSpot, box
from simgap.policies.learn import Training
from simgap.policies.residual_spot import ResidualSpot
from simgap.recordings import HISTORY
from simgap.residual.model import ResidualModel
from simgap.simulators.spot import SCHEMA
from simgap.types import Report
from tasks import transitions
from tasks.cells import Curve, finished, may_pass
from tasks.files.digests import fingerprint_of
from tasks.files.models import load_model, save_policy
from tasks.fingerprint import configuration_of_policy, of_policy, relevant_policy_params
from tasks.params import Params, PolicyParams
from tasks.tracking.models import log_policy
from tasks.tracking.runs import Run, cell_run
from tasks.train import Job
from tasks.workspace import Cell, Workspace


class Grid(NamedTuple):
    """What the policies share: the run of the whole grid in MLflow, its tags, the digest of the code, and that of the
    code that learns in a model with a residual."""

    run: Run
    tags: dict[str, str]
    code: str
    residual_code: str

    def code_of(self, cell: Cell) -> str:
        """Of what learns the cell's policy."""
        return self.residual_code if cell.method == "residual" else self.code


def grid(params: PolicyParams) -> list[Cell]:
    """The cells whose models get a policy, seed after seed: what is done at any time is the grid of fewer seeds."""
    return [
        Cell(params.noise, model, n, seed)
        for seed in params.seeds
        for n in params.sample_sizes
        for model in params.models
    ]


@task(task_run_name="policy-{cell.name}", retries=1, retry_condition_fn=may_pass)
def learn_policy(
    workspace: Workspace, cell: Cell, params: Params, grid: Grid, job: Job, clock: Callable[[], float]
) -> None:
    """Learn a cell's policy, unless that was done before; write it and its record, and log them.

    Goes on from the last evaluation where it was interrupted. `job` and `clock` as in `tasks.train`.
    """
    digest = transitions.digest(workspace)
    model = read_json(workspace.record(cell))["fingerprint"]
    mark = of_policy(cell, model, digest, params, grid.code_of(cell))
    with job(cell.name, params.policy.learning.environment_steps) as report:
        reused = finished(workspace.policy(cell), workspace.policy_record(cell), mark)
        if not reused:
            # Should this fail, the policy of other parameters must not pass for its result.
            remove_file(workspace.policy_record(cell), workspace.root)
            _learn(workspace, cell, params, mark, report, clock)
    log(workspace, cell, params, grid, {"transitions": digest, "model_fingerprint": model, "reused": str(reused)})


def _learn(
    workspace: Workspace, cell: Cell, params: Params, mark: str, report: Report, clock: Callable[[], float]
) -> None:
    """Learn and write; the record comes last, so that a policy killed halfway has none and is gone on with."""
    model = jax.tree.map(jnp.asarray, load_model(workspace.model(cell)))
    kind = ResidualSpot if isinstance(model, ResidualModel) else LearntSpot
    known, own = box(transitions.load(workspace, "training").x), params.policy
    environment = kind(cast(models.Model, model), known, own.environment, params.episode_bounds)
    checkpoint = Checkpoint(workspace, cell, mark)
    resumed, curve, before = checkpoint.load(environment, own)
    start, keep = clock(), Curve(report, curve)
    learnt = learn.learn(
        jax.random.key(cell.seed), environment, own.learning, own.sac, keep, resumed,
        lambda training: checkpoint.save(training, curve, before + clock() - start),
    )  # fmt: skip
    limit = jnp.array(own.environment.command_limit)
    save_policy(workspace.policy(cell), Actor(learnt.layers, learnt.mean, learnt.std, limit))
    record = {
        **cell._asdict(),
        "fingerprint": mark,
        "seconds": before + clock() - start,
        "steps": curve["step"][-1],
        "return": max(curve["return"]),
        "lost": curve["lost"][-1],
        "curve": curve,
    }
    write_json(workspace.policy_record(cell), record)
    checkpoint.remove()


class Checkpoint:
    """All that learning a cell's policy needs to go on from its last evaluation."""

    def __init__(self, workspace: Workspace, cell: Cell, mark: str) -> None:
        self._root = workspace.root
        self._arrays = workspace.checkpoint(cell)
        self._curve = self._arrays.with_suffix(".json")
        self._mark = mark

    def load(
        self, environment: LearntSpot, params: PolicyParams
    ) -> tuple[Training | None, dict[str, list[float]], float]:
        """State, curve so far and seconds spent; nothing where none of the same fingerprint is there and whole."""
        if fingerprint_of(self._curve, self._arrays) != self._mark:
            return None, {}, 0.0
        known = read_json(self._curve)
        arrays = load_arrays(self._arrays)
        evaluations = int(arrays.pop("evaluations"))
        if evaluations != len(known["curve"]["step"]):
            return None, {}, 0.0
        training = learn.from_arrays(arrays, environment, params.learning, params.sac)
        return training, known["curve"], known["seconds"]

    def save(self, training: Training, curve: dict[str, list[float]], seconds: float) -> None:
        """Two files, each whole or not there; where a kill came between them, they do not fit and are not used."""
        evaluations = {"evaluations": jnp.int32(len(curve["step"]))}
        save_arrays(self._arrays, {**learn.to_arrays(training), **evaluations})
        write_json(self._curve, {"fingerprint": self._mark, "curve": curve, "seconds": seconds})

    def remove(self) -> None:
        """Delete what is no longer needed."""
        for path in (self._arrays, self._curve):
            remove_file(path, self._root)


def log(workspace: Workspace, cell: Cell, params: Params, grid: Grid, tags: dict[str, str]) -> None:
    """A learnt policy as a run of the grid's: parameters, curve, data set, results, and the policy as a model."""
    record = read_json(workspace.policy_record(cell))
    config = configuration_of_policy(cell, params)
    tags = {**grid.tags, **tags, "fingerprint": record["fingerprint"], "config": config}
    with cell_run(grid.run.store, grid.run.run_id, cell.name, tags) as run:
        run.params({**cell._asdict(), **relevant_policy_params(params)})
        curve = dict(record["curve"])
        run.curve([int(step) for step in curve.pop("step")], curve)
        run.dataset(f"{workspace.source}-transitions", workspace.transitions, tags["transitions"], "training")
        known = {name: record[name] for name in ("steps", "return", "lost")}
        run.scores({"training_seconds": record["seconds"], **known})
        log_policy(run, workspace.policy(cell), input_columns(), [field.name for field in SCHEMA.command])


def input_columns() -> tuple[str, ...]:
    """What a policy takes: the state, the commands two rows and one row before, the goal."""
    past = [f"{field.name}_{k}" for k in range(HISTORY, 0, -1) for field in SCHEMA.command]
    return (*(field.name for field in SCHEMA.state), *past, "goal_x", "goal_y", "goal_z")


def remove_stale(workspace: Workspace, cells: Sequence[Cell]) -> None:
    """Delete what belongs to cells that the grid no longer has: a stage's output holds this grid alone."""
    wanted = {cell.name for cell in cells}
    for path in workspace.policies.glob("*"):
        if path.name.removesuffix(path.suffix).removesuffix(".checkpoint") not in wanted:
            remove_file(path, workspace.root)
