"""Stage `track`: every policy on the robot, its hand along an ellipse and a helix; tables, figures, claims."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from prefect import task

from simgap.policies import references
from simgap.policies.follow import Run, follow, mean_error
from simgap.policies.proportional import Proportional
from simgap.robots.virtual_robot import VirtualRobot
from simgap.robots.virtual_spot import VirtualSpotConfig
from simgap.types import Policy, Robot, SimgapError
from tasks import tracking
from tasks import tracking_plots as plots
from tasks.files.arrays import save_arrays
from tasks.files.documents import read_json, write_json, write_table, write_text
from tasks.params import PolicyParams, TrackParams
from tasks.plots import LABELS
from tasks.report import compare
from tasks.workspace import Cell, Workspace

Row = dict[str, Any]
REGISTERED = "policy"
"""The registered model whose versions are the best policies of tracking runs."""
SHAPES = ("ellipse", "helix")
IDENTITY = ("shape", "policy", "sample_size", "seed")
_WRITTEN = ("states", "commands", "goals")
_AVERAGED = ("mean_error", "completed", "return", "lost")


def shapes(params: TrackParams, time_step: float) -> dict[str, Float[np.ndarray, "T 3"]]:
    """The references by name, about the hand's place at the start [m]."""
    return {
        "ellipse": references.ellipse(params.ellipse, time_step),
        "helix": references.helix(params.helix, time_step),
    }


def robot(params: TrackParams) -> Robot:
    """The virtual Spot; what takes its place for a real one has the same four verbs."""
    return VirtualRobot(jax.random.key(params.seed), VirtualSpotConfig(), params.robot_limit)


def controllers(params: TrackParams) -> dict[str, Proportional]:
    """The proportional controllers, by name."""
    p = params.proportional
    return {
        f"proportional {gain:g} per s": Proportional(jnp.float32(gain), jnp.float32(p.base_gain), jnp.array(p.rest))
        for gain in p.gains
    }


@task(task_run_name="track-{name}")
def run(
    workspace: Workspace, name: str, policy: Policy, about: Row, params: TrackParams
) -> tuple[list[Row], dict[str, Run]]:
    """A policy along every reference: a row each, which begins with what is known `about` the policy, and the runs.

    A row tells the mean error [m], the share of the reference that was run, and what the hand was on course for where
    the run was stopped. What was done is written.
    """
    machine, rows, runs = robot(params), [], {}
    for shape, reference in shapes(params, machine.time_step).items():
        done = runs[shape] = follow(machine, policy, reference, params.bounds)
        result = {"mean_error": mean_error(done), "completed": len(done.states) / len(reference)}
        rows.append({"shape": shape, **about, **result, "stopped": done.stopped})
    arrays = {f"{shape}_{part}": getattr(done, part) for shape, done in runs.items() for part in _WRITTEN}
    save_arrays(workspace.runs(name), arrays)
    return rows, runs


def about(workspace: Workspace, cell: Cell) -> Row:
    """What is known of a learnt policy: its cell, its return in its own model, the share of rollouts lost there."""
    record = read_json(workspace.policy_record(cell))
    return {"policy": cell.model, "sample_size": cell.sample_size, "seed": cell.seed, "return": record["return"],
            "lost": record["lost"], "steps": record["steps"]}  # fmt: skip


def notes(workspace: Workspace, cells: Sequence[Cell], params: PolicyParams) -> list[str]:
    """How the policies were learnt, for the report: how many, for how long, and what set these parameters apart."""
    records = [read_json(workspace.policy_record(cell)) for cell in cells]
    learning, sac = params.learning, params.sac
    steps = [record["steps"] for record in records]
    sizes = ", ".join(str(n) for n in sorted({cell.sample_size for cell in cells}))
    early = sum(len(record["curve"]["step"]) < learning.evaluations for record in records)
    return [
        f"{len(cells)} policies: {len({cell.model for cell in cells})} models, N = {sizes}, seeds "
        f"{', '.join(str(seed) for seed in sorted({cell.seed for cell in cells}))}; models with {params.noise} noise. "
        f"Each learnt for {min(steps):,} to {max(steps):,} environment steps (the paper: 2,500,000) at a learning rate "
        f"of {sac.learning_rate_policy:g} (the paper: 0.0001); {early} of them ended at a plateau of the return. "
        f"An episode is lost beyond {params.environment.escape:g} times the recordings' box."
    ]


@task(task_run_name="log-track-{cell.name}", retries=1)
def log_cell(workspace: Workspace, cell: Cell, rows: Sequence[Row], store: tracking.Store) -> None:
    """Add the errors to the latest run of the policy in MLflow, if this store has one."""
    found = tracking.latest_run(store, {"fingerprint": read_json(workspace.policy_record(cell))["fingerprint"]})
    if found:
        found.scores({f"{row['shape']}/{score}": row[score] for row in rows for score in ("mean_error", "completed")
                      if not math.isnan(row[score])})  # fmt: skip


def summarise(rows: Sequence[Row]) -> list[Row]:
    """Means over seeds, the spread of the error, and how many runs were stopped: by shape, policy and N."""
    groups: dict[tuple[str, str, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["shape"], row["policy"], row.get("sample_size", 0)), []).append(row)
    return [
        {
            "shape": shape,
            "policy": policy,
            **({"sample_size": n} if n else {}),
            "runs": len(members),
            **{score: float(np.mean([m[score] for m in members])) for score in _AVERAGED if score in members[0]},
            "mean_error_std": float(np.std([m["mean_error"] for m in members], ddof=1)) if len(members) > 1 else 0.0,
            "stopped": sum(bool(m["stopped"]) for m in members),
        }
        for (shape, policy, n), members in sorted(groups.items())
    ]


def claims(rows: Sequence[Row], shape: str) -> list[tuple[str, str]]:
    """The paper's claims on tracking [Hoffman et al. 2025, Shape Tracking], each with what these runs say."""
    learnt = [{**r, "noise": shape, "model": r["policy"]} for r in rows if r["shape"] == shape and _learnt(r)]
    answers = []
    for other in ("fsvgd", "sim_model"):
        table = compare(learnt, shape, "sim_fsvgd", other, "mean_error")
        if table:
            answers.append((f"Sim-FSVGD below {LABELS[other]} at every N", f"**{_verdict(table)}** ({_told(table)})"))
    few, many = _mean(learnt, "sim_fsvgd", 1000), _mean(learnt, "fsvgd", 5000)
    if few and many:
        verdict = "holds" if many > few else "does not hold"
        answers.append(("FSVGD at N = 5000 worse than Sim-FSVGD at N = 1000",
                        f"**{verdict}** ({many:.3f} against {few:.3f} m)"))  # fmt: skip
    ours = _mean(learnt, "sim_fsvgd", 2000)
    for other, paper in (("fsvgd", 2.47), ("sim_model", 2.53)):
        theirs = _mean(learnt, other, 2000)
        if shape == "ellipse" and ours and theirs:
            answers.append((f"At N = 2000 {LABELS[other]} has {paper} times Sim-FSVGD's error",
                            f"**{theirs / ours:.2f} times** ({theirs:.3f} against {ours:.3f} m)"))  # fmt: skip
    return answers


def against_controllers(rows: Sequence[Row], shape: str) -> list[tuple[str, str]]:
    """The best learnt policy that was not stopped against every controller, which ignore the delay."""
    whole = [r for r in rows if r["shape"] == shape and not r["stopped"]]
    learnt = min((r for r in whole if _learnt(r)), key=lambda r: r["mean_error"], default=None)
    if learnt is None:
        return []
    name = f"{LABELS[learnt['policy']]} at N = {learnt['sample_size']}, seed {learnt['seed']}"
    answers = []
    for row in (r for r in rows if r["shape"] == shape and not _learnt(r)):
        verdict = "better" if row["stopped"] or learnt["mean_error"] < row["mean_error"] else "worse"
        theirs = f"{row['mean_error']:.3f} m" + (f" until stopped ({row['stopped']})" if row["stopped"] else "")
        answers.append((f"Best policy against {row['policy']}", f"**{verdict}** ({learnt['mean_error']:.3f} m, {name}, "
                        f"against {theirs})"))  # fmt: skip
    return answers


def _verdict(table: Sequence[Row]) -> str:
    """Whether the difference is below 0 at every N; with one seed there is no telling it from chance."""
    below = sum(r["verdict"] == "below" for r in table)
    if all(r["seeds"] == 1 for r in table):
        return "open: one seed"
    return "holds" if below == len(table) else f"holds at {below} of {len(table)} N" if below else "does not hold"


def _told(table: Sequence[Row]) -> str:
    error = lambda r: f" ± {1000 * r['standard_error']:.0f}" if r["seeds"] > 1 else ""  # noqa: E731
    return ", ".join(f"{1000 * r['difference']:+.0f}{error(r)} mm at N = {r['sample_size']}" for r in table)


def _mean(rows: Sequence[Row], policy: str, sample_size: int) -> float:
    """Mean over seeds of the mean error [m]; 0 where there is none."""
    found = [r["mean_error"] for r in rows if r["policy"] == policy and r["sample_size"] == sample_size]
    return float(np.mean(found)) if found else 0.0


@task(task_run_name="report-track-{workspace.source}")
def write(
    workspace: Workspace, rows: list[Row], runs: Mapping[tuple[str, str, int, int], Run], notes: Sequence[str], dpi: int
) -> list[Row]:
    """Tables, metrics, figures, an animation and the written report; returns the summary.

    `runs`: those of learnt policies, by shape, model, N and seed. `notes`: lines on how the policies were learnt.
    """
    folder, summary = workspace.tracking, summarise(rows)
    write_table(folder / "errors.csv", [{**{k: r.get(k, "") for k in IDENTITY}, **r} for r in rows])
    write_table(folder / "summary.csv", summary)
    write_json(folder / "metrics.json", _metrics(summary))
    learnt = [r for r in rows if _learnt(r)]
    plots.error_against_n(folder / "error_against_n.png", learnt, best_controller(rows), dpi)
    for shape in SHAPES:
        chosen = {key[1:]: run for key, run in runs.items() if key[0] == shape}
        plots.trajectories(folder / f"{shape}_plane.png", chosen, shape, dpi)
        plots.trajectories_3d(folder / f"{shape}_3d.png", chosen, shape, dpi)
    best = min((r for r in learnt if r["shape"] == "helix"), key=lambda r: (-r["completed"], r["mean_error"]))
    title = f"{LABELS[best['policy']]}, N = {best['sample_size']}, seed {best['seed']}: {best['mean_error']:.3f} m"
    plots.animate(folder / "helix.gif", runs["helix", best["policy"], best["sample_size"], best["seed"]], title)
    write_text(folder / "report.md", _markdown(workspace.source, rows, summary, notes))
    return summary


@task(task_run_name="register-{name}", retries=1)
def register_best(workspace: Workspace, rows: Sequence[Row], noise: str, name: str, store: tracking.Store) -> str:
    """The policy with the lowest mean error over the shapes, one stopped early behind all others, as the next version
    of the registered model `policy` with the alias `name`; returns its run's id. `noise`: of the policies' models."""
    found: dict[Cell, list[Row]] = {}
    for row in (r for r in rows if _learnt(r)):
        found.setdefault(Cell(noise, row["policy"], row["sample_size"], row["seed"]), []).append(row)
    cost = {cell: (sum(bool(r["stopped"]) for r in own), float(np.mean([r["mean_error"] for r in own])))
            for cell, own in found.items()}  # fmt: skip
    best = min(cost, key=cost.__getitem__)
    mark = {"fingerprint": read_json(workspace.policy_record(best))["fingerprint"]}
    run = tracking.latest_run(store, mark)
    if run is None:
        raise SimgapError(f"MLflow has no finished run of the policy {best.name}. Start the same run again.")
    run.register(REGISTERED, [name, "newest"], {"cell": best.name, "mean_error": f"{cost[best][1]:.4f}"})
    run.tags({"best_of": name})
    return run.run_id


def best_controller(rows: Sequence[Row]) -> dict[str, float]:
    """By shape, the mean error [m] of the best controller that is not learnt and was not stopped."""
    best: dict[str, float] = {}
    for row in rows:
        if not _learnt(row) and not row["stopped"]:
            best[row["shape"]] = min(row["mean_error"], best.get(row["shape"], math.inf))
    return best


def _learnt(row: Row) -> bool:
    return "seed" in row


@task(task_run_name="log-track-{workspace.source}", retries=1)
def log(run: tracking.Run, workspace: Workspace, summary: Sequence[Row]) -> None:
    """The summary's numbers and everything in the report's folder."""
    run.scores({"/".join(map(str, _path(r))) + "/mean_error": r["mean_error"] for r in summary
                if not math.isnan(r["mean_error"])})  # fmt: skip
    for path in sorted(workspace.tracking.glob("*")):
        run.artifact(path)


def _path(row: Row) -> list[str]:
    return [row["shape"], row["policy"], *([f"N{row['sample_size']}"] if "sample_size" in row else [])]


def _metrics(summary: Sequence[Row]) -> dict[str, Any]:
    metrics: dict[str, Any] = {}
    for r in summary:
        *path, last = _path(r)
        leaf = metrics
        for name in path:
            leaf = leaf.setdefault(name, {})
        leaf[last] = {score: r[score] for score in ("mean_error", "mean_error_std", "completed", "stopped")}
    return metrics


def _markdown(source: str, rows: Sequence[Row], summary: Sequence[Row], notes: Sequence[str]) -> str:
    lines = [f"# Shape tracking on the virtual Spot, policies learnt from recordings: {source}", "", *notes, ""]
    lines += [
        "Mean distance between hand and goal [m], over the rows that were run, mean ± standard deviation over seeds. A "
        "run that is on course for a collision is stopped early: its error is that of its truncated part, and it is "
        "counted.",
        "",
        "![Tracking error against N](error_against_n.png)",
        "",
    ]
    if source != "virtual":
        lines += ["These policies were learnt from another robot than the one they are run on.", ""]
    for shape in SHAPES:
        lines += [f"## {shape.capitalize()}", ""]
        answers = claims(rows, shape)
        if answers:
            lines += ["The paper's claims (differences paired by seed, ± standard error):", ""]
            lines += [f"- {claim}: {answer}" for claim, answer in answers] + [""]
        answers = against_controllers(rows, shape)
        lines += [f"- {claim}: {answer}" for claim, answer in answers] + [""] * bool(answers)
        lines += ["| policy | N | mean error [m] | completed | stopped early | return in its model | lost there |",
                  "| --- | --- | --- | --- | --- | --- | --- |"]  # fmt: skip
        for r in (r for r in summary if r["shape"] == shape):
            inside = f"{r['return']:.0f} | {r['lost']:.0%}" if "return" in r else "- | -"
            lines.append(f"| {LABELS.get(r['policy'], r['policy'])} | {r.get('sample_size', '-')} | "
                         f"{_mean_and_spread(r)} | {r['completed']:.0%} | "
                         f"{r['stopped']} of {r['runs']}{_why(rows, r)} | {inside} |")  # fmt: skip
        lines += ["", f"![{shape} in the plane]({shape}_plane.png)", "", f"![{shape} in 3-D]({shape}_3d.png)", ""]
    lines += ["## One run", "", "![The helix, the best run](helix.gif)", ""]
    return "\n".join(lines)


def _mean_and_spread(row: Row) -> str:
    return f"{row['mean_error']:.3f}" + (f" ± {row['mean_error_std']:.3f}" if row["runs"] > 1 else "")


def _why(rows: Sequence[Row], summary: Row) -> str:
    """What the stopped runs of a summary's row were on course for."""
    key = ("shape", "policy", "sample_size")
    found = [r["stopped"] for r in rows if r["stopped"] and all(r.get(k) == summary.get(k) for k in key)]
    return f" ({', '.join(sorted(set(found)))})" if found else ""
