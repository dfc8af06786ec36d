"""Stage `report`: tables, figures and the paper's claims, from the scores of a grid."""

import statistics
from collections.abc import Sequence
from typing import Any

from prefect import task

from tasks import files, plots
from tasks.plots import LABELS
from tasks.workspace import Workspace

Row = dict[str, Any]
IDENTITY = ("noise", "model", "sample_size", "seed")
HEADLINE = ("nll", "nll_median", "calibration_error", "rollout_ee_10", "rollout_ee_50", "rollout_base_10",
            "rollout_base_50")  # fmt: skip


def summarise(rows: Sequence[Row]) -> list[Row]:
    """Mean and spread (standard deviation) over seeds of every score, a row per noise, model and N."""
    groups: dict[tuple[str, str, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["noise"], row["model"], row["sample_size"]), []).append(row)
    table = []
    for (noise, model, n), members in sorted(groups.items()):
        summary: Row = {"noise": noise, "model": model, "sample_size": n, "seeds": len(members)}
        for score in (k for k in members[0] if k not in IDENTITY):
            values = [m[score] for m in members]
            summary[score] = statistics.fmean(values)
            summary[f"{score}_std"] = statistics.stdev(values) if len(values) > 1 else 0.0
        table.append(summary)
    return table


def compare(rows: Sequence[Row], noise: str, model: str, other: str, score: str = "nll") -> list[Row]:
    """`model` against `other` at every N, paired by seed (the same draw): mean difference and its standard error.

    The verdict is `below` or `above` where the difference exceeds two standard errors, `level` otherwise or when fewer
    than two seeds are there.
    """
    score_of = {(r["model"], r["sample_size"], r["seed"]): r[score] for r in rows if r["noise"] == noise}
    table = []
    for n in sorted({size for _, size, _ in score_of}):
        seeds = sorted(s for m, size, s in score_of if m == model and size == n and (other, n, s) in score_of)
        if not seeds:
            continue
        differences = [score_of[model, n, s] - score_of[other, n, s] for s in seeds]
        mean = statistics.fmean(differences)
        error = statistics.stdev(differences) / len(differences) ** 0.5 if len(differences) > 1 else float("inf")
        verdict = "level" if abs(mean) <= 2 * error else "below" if mean < 0 else "above"
        table.append({"noise": noise, "model": model, "other": other, "sample_size": n, "seeds": len(seeds),
                      "difference": mean, "standard_error": error, "verdict": verdict})  # fmt: skip
    return table


def claims(rows: Sequence[Row], noise: str) -> list[tuple[str, str]]:
    """The paper's claims on NLL [Hoffman et al. 2025, Model Validation], each with what these scores say."""
    against_fsvgd = compare(rows, noise, "sim_fsvgd", "fsvgd")
    against_sim = compare(rows, noise, "sim_fsvgd", "sim_model")
    checked = [
        ("Sim-FSVGD below FSVGD at every N", against_fsvgd, lambda _: "below"),
        ("Sim-FSVGD level with SIM-MODEL at N = 1000, below it from 2000 on", against_sim,
         lambda n: "above" if n < 1000 else "level" if n == 1000 else "below"),
    ]  # fmt: skip
    answers = []
    for claim, table, expected in checked:
        held = [row["verdict"] == expected(row["sample_size"]) for row in table]
        details = ", ".join(
            f"N = {row['sample_size']}: {row['difference']:+.2f} ± {row['standard_error']:.2f} ({row['verdict']})"
            for row in table
        )
        if table:
            answers.append((claim, f"{'holds' if all(held) else f'holds at {sum(held)} of {len(held)} N'}; {details}"))
    return answers


@task(task_run_name="report-{workspace.source}")
def write(workspace: Workspace, rows: list[Row], noises: Sequence[str], dpi: int) -> list[Row]:
    """Tables, metrics, figures and the written report; returns the summary table."""
    folder = workspace.reports
    summary = summarise(rows)
    files.write_table(folder / "scores.csv", rows)
    files.write_table(folder / "summary.csv", summary)
    files.write_table(
        folder / "nll.csv",
        [{"sample_size": r["sample_size"], "nll": r["nll"], "model": f"{r['noise']}/{r['model']}"} for r in summary],
    )
    files.write_json(folder / "metrics.json", _metrics(summary))
    title = f"recordings: {workspace.source}"
    plots.against_n(
        folder / "nll_against_n.png", rows, [(s, "nll", "NLL on test sessions (lower is better)") for s in noises],
        title, dpi,
    )  # fmt: skip
    if "rollout_ee_50" in summary[0]:
        plots.against_n(
            folder / "rollouts_against_n.png", rows,
            [(s, "rollout_ee_50", "end-effector error after 50 steps [m]") for s in noises], title, dpi,
        )  # fmt: skip
    files.write_text(folder / "report.md", _markdown(workspace.source, rows, summary, noises))
    return summary


def _metrics(summary: Sequence[Row]) -> dict[str, Any]:
    metrics: dict[str, Any] = {}
    for row in summary:
        leaf = metrics.setdefault(row["noise"], {}).setdefault(row["model"], {})
        leaf[f"N{row['sample_size']}"] = {score: row[score] for score in HEADLINE if score in row}
    return metrics


def _markdown(source: str, rows: Sequence[Row], summary: Sequence[Row], noises: Sequence[str]) -> str:
    lines = [f"# Model validation on recordings: {source}", ""]
    lines += ["Scores on test sessions, mean ± standard deviation over seeds. NLL is the joint one of the 13 outputs, "
              "mean over points, in original units; rollout errors are distances in metres.", ""]  # fmt: skip
    lines += ["![NLL against N](nll_against_n.png)", ""]
    if "rollout_ee_50" in summary[0]:
        lines += ["![Rollout error against N](rollouts_against_n.png)", ""]
    for noise in noises:
        lines += [f"## Setting `{noise}`", ""]
        answers = claims(rows, noise)
        if answers:
            lines += ["The paper's claims (difference in NLL, paired by seed, ± standard error):", ""]
            lines += [f"- {claim}: **{answer}**" for claim, answer in answers] + [""]
        scores = [s for s in HEADLINE if s in summary[0]]
        lines += ["| model | N | " + " | ".join(scores) + " | steps | seconds |"]
        lines += ["| --- | --- |" + " --- |" * (len(scores) + 2)]
        for row in (r for r in summary if r["noise"] == noise):
            cells = [_mean_and_spread(row, score) for score in scores]
            lines.append(f"| {LABELS[row['model']]} | {row['sample_size']} | " + " | ".join(cells)
                         + f" | {row['steps']:,.0f} | {row['seconds']:.0f} |")  # fmt: skip
        lines.append("")
    return "\n".join(lines)


def _mean_and_spread(row: Row, score: str) -> str:
    mean, spread = row[score], row[f"{score}_std"]
    return f"{mean:.2f} ± {spread:.2f}" if score.startswith("nll") else f"{mean:.3g} ± {spread:.2g}"
