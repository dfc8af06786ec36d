"""Report of the stage `track`: tables, figures, the paper's claims."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from prefect import task

from simgap.formats.documents import read_json, write_json, write_table, write_text
from simgap.policies.follow import Run
from tasks import track_plots as plots
from tasks.params import PolicyParams
from tasks.plots import LABELS
from tasks.report import compare
from tasks.twin import UNKNOWN
from tasks.twin_report import METRICS
from tasks.workspace import Cell, Workspace

Row = dict[str, Any]
SHAPES = ("ellipse", "helix")
IDENTITY = ("shape", "policy", "sample_size", "seed")
_AVERAGED = ("mean_error", "completed", "return", "lost")


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
    learnt = [r for r in rows if is_learnt(r)]
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


def on(workspace: Workspace, recorded: bool) -> str:
    """What the policies ran on, and how well it stands in for the robot."""
    if not recorded:
        return "The robot is the virtual Spot that the recordings come from."
    error = read_json(workspace.twin_report / METRICS)[UNKNOWN]
    name = max((n for n in error if n.startswith("rollout_ee_")), key=lambda n: int(n.rsplit("_", 1)[1]))
    return (
        f"The robot is the [twin](../twin/report.md) of the recorded one. Its own prediction of the hand is off by "
        f"{error[name]:.2f} m after {name.rsplit('_', 1)[1]} rows on sessions that were held out, without feedback; a "
        "policy sees the twin's state at every row. Differences between models count here as far as the twin shares "
        "the robot's physics: delays, lags, limits and stalls as they were recorded, no contact."
    )


def notes(workspace: Workspace, cells: Sequence[Cell], params: PolicyParams) -> list[str]:
    """How the policies were learnt, for the report: how many, for how long, and what set these parameters apart."""
    records = [read_json(workspace.policy_record(cell)) for cell in cells]
    learning, sac = params.learning, params.sac
    steps = [record["steps"] for record in records]
    sizes = ", ".join(str(n) for n in sorted({cell.sample_size for cell in cells}))
    early = sum(len(record["curve"]["step"]) < learning.evaluations for record in records)
    stopped = ", and where a run would be stopped" if params.environment.stopped else ""
    return [
        f"{len(cells)} policies: {len({cell.model for cell in cells})} models, N = {sizes}, seeds "
        f"{', '.join(str(seed) for seed in sorted({cell.seed for cell in cells}))}; models with {params.noise} noise. "
        f"Each learnt for at most {max(steps):,} environment steps (the paper: 2,500,000) at a learning rate "
        f"of {sac.learning_rate_policy:g} (the paper: 0.0001); {early} of them ended at a plateau of the return. "
        f"An episode is lost beyond {params.environment.escape:g} times the recordings' box{stopped}."
    ]


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
    learnt = [{**r, "noise": shape, "model": r["policy"]} for r in rows if r["shape"] == shape and is_learnt(r)]
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
    learnt = min((r for r in whole if is_learnt(r)), key=lambda r: r["mean_error"], default=None)
    if learnt is None:
        return []
    name = f"{LABELS[learnt['policy']]} at N = {learnt['sample_size']}, seed {learnt['seed']}"
    answers = []
    for row in (r for r in rows if r["shape"] == shape and not is_learnt(r)):
        verdict = "better" if row["stopped"] or learnt["mean_error"] < row["mean_error"] else "worse"
        theirs = f"{row['mean_error']:.3f} m" + (f" until stopped ({row['stopped']})" if row["stopped"] else "")
        answers.append((f"Best policy against {row['policy']}", f"**{verdict}** ({learnt['mean_error']:.3f} m, {name}, "
                        f"against {theirs})"))  # fmt: skip
    return answers


def best_controller(rows: Sequence[Row]) -> dict[str, float]:
    """By shape, the mean error [m] of the best controller that is not learnt and was not stopped."""
    best: dict[str, float] = {}
    for row in rows:
        if not is_learnt(row) and not row["stopped"]:
            best[row["shape"]] = min(row["mean_error"], best.get(row["shape"], math.inf))
    return best


def is_learnt(row: Row) -> bool:
    """Whether a row is of a learnt policy; controllers have no seed."""
    return "seed" in row


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


def path_of(row: Row) -> list[str]:
    """A row of the summary by names: shape, policy, and N where there is one."""
    return [row["shape"], row["policy"], *([f"N{row['sample_size']}"] if "sample_size" in row else [])]


def _metrics(summary: Sequence[Row]) -> dict[str, Any]:
    metrics: dict[str, Any] = {}
    for r in summary:
        *path, last = path_of(r)
        leaf = metrics
        for name in path:
            leaf = leaf.setdefault(name, {})
        leaf[last] = {score: r[score] for score in ("mean_error", "mean_error_std", "completed", "stopped")}
    return metrics


def _markdown(source: str, rows: Sequence[Row], summary: Sequence[Row], notes: Sequence[str]) -> str:
    lines = [f"# Shape tracking: {source}", ""]
    for note in notes:
        lines += [note, ""]
    lines += [
        "Mean distance between hand and goal [m], over the rows that were run, mean ± standard deviation over seeds. A "
        "run that is on course for a collision is stopped early: its error is that of its truncated part, and it is "
        "counted.",
        "",
        "![Tracking error against N](error_against_n.png)",
        "",
    ]
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
