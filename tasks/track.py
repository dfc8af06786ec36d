"""Stage `track`: every policy on the robot, its hand along an ellipse and a helix."""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from prefect import task

from simgap.formats.arrays import save_arrays
from simgap.formats.documents import read_json
from simgap.policies import follow, references
from simgap.policies.proportional import Proportional
from simgap.robots.twin.robot import TwinRobot
from simgap.robots.virtual_robot import VirtualRobot
from simgap.robots.virtual_spot import VirtualSpotConfig
from simgap.types import Policy, Robot, SimgapError
from tasks.files.twins import load_twin
from tasks.params import TrackParams
from tasks.track_report import Row, is_learnt, path_of
from tasks.tracking.runs import Run, latest_run
from tasks.tracking.store import Store
from tasks.workspace import Cell, Workspace

REGISTERED = "policy"
"""The registered model whose versions are the best policies of tracking runs."""
_WRITTEN = ("states", "commands", "goals")


def shapes(params: TrackParams, time_step: float) -> dict[str, Float[np.ndarray, "T 3"]]:
    """The references by name, about the hand's place at the start [m]."""
    return {
        "ellipse": references.ellipse(params.ellipse, time_step),
        "helix": references.helix(params.helix, time_step),
    }


def robot(workspace: Workspace, recorded: bool, params: TrackParams) -> Robot:
    """What the sessions come from: the virtual Spot, or the twin of a recorded one.

    A real robot that takes its place has the same four verbs. SimgapError where there is no twin yet.
    """
    key = jax.random.key(params.seed)
    if recorded:
        return TwinRobot(key, load_twin(workspace.twin), params.robot_limit)
    return VirtualRobot(key, VirtualSpotConfig(), params.robot_limit)


def controllers(params: TrackParams) -> dict[str, Proportional]:
    """The proportional controllers, by name."""
    p = params.proportional
    return {
        f"proportional {gain:g} per s": Proportional(jnp.float32(gain), jnp.float32(p.base_gain), jnp.array(p.rest))
        for gain in p.gains
    }


@task(task_run_name="track-{name}")
def run(
    workspace: Workspace, name: str, policy: Policy, about: Row, machine: Robot, params: TrackParams
) -> tuple[list[Row], dict[str, follow.Run]]:
    """A policy on `machine` along every reference: a row each, which begins with what is known `about` the policy, and
    the runs.

    A row tells the mean error [m], the share of the reference that was run, and what the hand was on course for where
    the run was stopped. What was done is written.
    """
    rows: list[Row] = []
    runs: dict[str, follow.Run] = {}
    for shape, reference in shapes(params, machine.time_step).items():
        done = runs[shape] = follow.follow(machine, policy, reference, params.bounds)
        result = {"mean_error": follow.mean_error(done), "completed": len(done.states) / len(reference)}
        rows.append({"shape": shape, **about, **result, "stopped": done.stopped})
    arrays = {f"{shape}_{part}": getattr(done, part) for shape, done in runs.items() for part in _WRITTEN}
    save_arrays(workspace.runs(name), arrays)
    return rows, runs


def about(workspace: Workspace, cell: Cell) -> Row:
    """What is known of a learnt policy: its cell, its return in its own model, the share of rollouts lost there."""
    record = read_json(workspace.policy_record(cell))
    return {"policy": cell.model, "sample_size": cell.sample_size, "seed": cell.seed, "return": record["return"],
            "lost": record["lost"], "steps": record["steps"]}  # fmt: skip


@task(task_run_name="log-track-{cell.name}", retries=1)
def log_cell(workspace: Workspace, cell: Cell, rows: Sequence[Row], store: Store) -> None:
    """Add the errors to the latest run of the policy in MLflow, if this store has one."""
    found = latest_run(store, {"fingerprint": read_json(workspace.policy_record(cell))["fingerprint"]})
    if found:
        found.scores({f"{row['shape']}/{score}": row[score] for row in rows for score in ("mean_error", "completed")
                      if not math.isnan(row[score])})  # fmt: skip


@task(task_run_name="register-{name}", retries=1)
def register_best(workspace: Workspace, rows: Sequence[Row], noise: str, name: str, store: Store) -> str:
    """The policy with the lowest mean error over the shapes, one stopped early behind all others, as the next version
    of the registered model `policy` with the alias `name`; returns its run's id. `noise`: of the policies' models."""
    found: dict[Cell, list[Row]] = {}
    for row in (r for r in rows if is_learnt(r)):
        found.setdefault(Cell(noise, row["policy"], row["sample_size"], row["seed"]), []).append(row)
    cost = {cell: (sum(bool(r["stopped"]) for r in own), float(np.mean([r["mean_error"] for r in own])))
            for cell, own in found.items()}  # fmt: skip
    best = min(cost, key=cost.__getitem__)
    mark = {"fingerprint": read_json(workspace.policy_record(best))["fingerprint"]}
    run = latest_run(store, mark)
    if run is None:
        raise SimgapError(f"MLflow has no finished run of the policy {best.name}. Start the same run again.")
    run.register(REGISTERED, [name, "newest"], {"cell": best.name, "mean_error": f"{cost[best][1]:.4f}"})
    run.tags({"best_of": name})
    return run.run_id


@task(task_run_name="log-track-{workspace.source}", retries=1)
def log(run: Run, workspace: Workspace, summary: Sequence[Row]) -> None:
    """The summary's numbers and everything in the report's folder."""
    run.scores({"/".join(map(str, path_of(r))) + "/mean_error": r["mean_error"] for r in summary
                if not math.isnan(r["mean_error"])})  # fmt: skip
    for path in sorted(workspace.tracking.glob("*")):
        run.artifact(path)
