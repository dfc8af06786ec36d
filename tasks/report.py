"""Stage `report`: tables, figures and the paper's claims, from the scores of a grid."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from prefect import task

from simgap.formats.documents import write_json, write_table, write_text
from tasks import plots
from tasks.plots import LABELS
from tasks.workspace import DIAGNOSED, Workspace

Row = dict[str, Any]
IDENTITY = ("noise", "model", "sample_size", "seed")
EFFECTS = "effects"
"""Column of the effects that a cell's diagnosis found; empty where it found none, absent where it has no diagnosis."""
HEADLINE = ("nll", "nll_median", "validation_nll", "calibration_error")


def summarise(rows: Sequence[Row]) -> list[Row]:
    """Mean and spread (standard deviation) over seeds of every score, a row per noise, model and N."""
    groups: dict[tuple[str, str, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["noise"], row["model"], row["sample_size"]), []).append(row)
    table = []
    for (noise, model, n), members in sorted(groups.items()):
        summary: Row = {"noise": noise, "model": model, "sample_size": n, "seeds": len(members)}
        for score in (k for k in members[0] if k not in (*IDENTITY, EFFECTS)):
            values = [m[score] for m in members]
            summary[score] = float(np.mean(values))
            summary[f"{score}_std"] = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
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
        mean = float(np.mean(differences))
        error = float(np.std(differences, ddof=1)) / len(differences) ** 0.5 if len(differences) > 1 else float("inf")
        verdict = "level" if abs(mean) <= 2 * error else "below" if mean < 0 else "above"
        table.append({"noise": noise, "model": model, "other": other, "sample_size": n, "seeds": len(seeds),
                      "difference": mean, "standard_error": error, "verdict": verdict})  # fmt: skip
    return table


def claims(rows: Sequence[Row], noise: str) -> list[tuple[str, str]]:
    """The paper's claims on NLL [Hoffman et al. 2025, Model Validation], each with what these scores say."""
    against_fsvgd = compare(rows, noise, "sim_fsvgd", "fsvgd")
    against_sim = [r for r in compare(rows, noise, "sim_fsvgd", "sim_model") if r["sample_size"] >= 1000]
    similar, surpassed = (
        [r for r in against_sim if r["sample_size"] < 2000],
        [r for r in against_sim if r["sample_size"] >= 2000],
    )
    checked = (
        ("Sim-FSVGD below FSVGD at every N", "below", against_fsvgd),
        ("Sim-FSVGD level with SIM-MODEL at N = 1000", "level", similar),
        ("Sim-FSVGD below SIM-MODEL from N = 2000 on", "below", surpassed),
    )
    return [(claim, _answer(expected, table)) for claim, expected, table in checked if table]


def diagnosis_adds(rows: Sequence[Row], noise: str) -> list[tuple[str, str]]:
    """Every model that is given a diagnosed simulator against its twin that is not: (label, differences in NLL)."""
    found = []
    for model in (m for m in LABELS if m.endswith(DIAGNOSED)):
        twin = model.removesuffix(DIAGNOSED)
        twin = twin if twin in LABELS else f"sim_model{DIAGNOSED}"  # of a residual: its simulator alone
        table = compare(rows, noise, model, twin)
        if table:
            held = {verdict: sum(row["verdict"] == verdict for row in table) for verdict in ("below", "level", "above")}
            counts = ", ".join(f"{verdict} at {count}" for verdict, count in held.items() if count)
            against = f"of {len(table)} N against {LABELS[twin]}"
            found.append((LABELS[model], f"**{counts}** {against} ({_differences(table)})"))
    return found


def effects_found(rows: Sequence[Row]) -> list[str]:
    """What the diagnoses found, a line per N; a seed's diagnosis is shared by models and noises."""
    found = {(row["sample_size"], row["seed"]): row[EFFECTS] or "none" for row in rows if row.get(EFFECTS) is not None}
    lines = []
    for n in sorted({size for size, _ in found}):
        seeds: dict[str, list[str]] = {}
        for (size, seed), effects in sorted(found.items()):
            if size == n:
                seeds.setdefault(effects, []).append(str(seed))
        by_seed = "; ".join(f"{effects} (seed {', '.join(which)})" for effects, which in seeds.items())
        lines.append(f"N = {n}: {by_seed}")
    return lines


def _answer(expected: str, table: Sequence[Row]) -> str:
    held = sum(row["verdict"] == expected for row in table)
    verdict = "holds" if held == len(table) else f"holds at {held} of {len(table)} N" if held else "does not hold"
    return f"**{verdict}** ({_differences(table)})"


def _differences(table: Sequence[Row]) -> str:
    return ", ".join(
        f"{row['difference']:+.2f} ± {row['standard_error']:.2f} at N = {row['sample_size']}" for row in table
    )


@task(task_run_name="report-{workspace.source}")
def write(workspace: Workspace, rows: list[Row], noises: Sequence[str], dpi: int) -> list[Row]:
    """Tables, metrics, figures and the written report; returns the summary table."""
    folder = workspace.reports
    summary = summarise(rows)
    write_table(folder / "scores.csv", [{**{name: row[name] for name in IDENTITY}, **row} for row in rows])
    write_table(folder / "summary.csv", summary)
    write_table(folder / "nll.csv", _wide(summary, "nll"))
    write_json(folder / "metrics.json", _metrics(summary))
    title = f"recordings: {workspace.source}"
    plots.against_n(
        folder / "nll_against_n.png", rows, [(s, "nll", "NLL on test sessions (lower is better)") for s in noises],
        title, dpi,
    )  # fmt: skip
    longest = max(_rollout_scores(summary), key=_horizon)
    label = f"end-effector error after {_horizon(longest)} steps [m]"
    plots.against_n(folder / "rollouts_against_n.png", rows, [(s, longest, label) for s in noises], title, dpi)
    write_text(folder / "report.md", _markdown(workspace.source, rows, summary, noises))
    return summary


def _rollout_scores(summary: Sequence[Row]) -> list[str]:
    return [name for name in summary[0] if name.startswith("rollout_ee_") and not name.endswith("_std")]


def _horizon(score: str) -> int:
    return int(score.rsplit("_", 1)[1])


def _wide(summary: Sequence[Row], score: str) -> list[Row]:
    """A row per N, a column per noise and model: what `dvc plots` draws."""
    table: dict[int, Row] = {}
    for row in summary:
        columns = table.setdefault(row["sample_size"], {"sample_size": row["sample_size"]})
        columns[f"{row['noise']}_{row['model']}"] = row[score]
    return [table[n] for n in sorted(table)]


def _headline(summary: Sequence[Row]) -> list[str]:
    return [*HEADLINE, *_rollout_scores(summary)]


def _metrics(summary: Sequence[Row]) -> dict[str, float]:
    """What `dvc metrics show` prints: every model's NLL at the largest N, under the noise where it is lowest."""
    largest = max(row["sample_size"] for row in summary)
    metrics: dict[str, float] = {}
    for row in (r for r in summary if r["sample_size"] == largest):
        name = f"nll_{row['model']}"
        metrics[name] = float(np.fmin(row["nll"], metrics.get(name, math.nan)))
    return metrics


def _markdown(source: str, rows: Sequence[Row], summary: Sequence[Row], noises: Sequence[str]) -> str:
    lines = [f"# Model validation on recordings: {source}", ""]
    lines += [
        "Scores on test sessions, mean ± standard deviation over seeds. NLL is that of the 13 outputs jointly, mean "
        "over points, in original units, lower is better; validation NLL is within the N. Rollout errors are distances "
        "in metres after that many steps.",
        "",
    ]
    lines += ["![NLL against N](nll_against_n.png)", "", "![Rollout error against N](rollouts_against_n.png)", ""]
    found = effects_found(rows)
    if found:
        lines += ["Effects that a diagnosis of as many transitions found, and that the models called diagnosed have:"]
        lines += ["", *(f"- {line}" for line in found), ""]
    for noise in noises:
        lines += [f"## {plots.NOISES[noise]}", ""]
        answers = claims(rows, noise)
        if answers:
            lines += ["The paper's claims (difference in NLL, paired by seed, ± standard error):", ""]
            lines += [f"- {claim}: {answer}" for claim, answer in answers] + [""]
        added = diagnosis_adds(rows, noise)
        if added:
            lines += ["What the diagnosis adds (difference in NLL to the same model without it, paired by seed, ± "
                      "standard error):", ""]  # fmt: skip
            lines += [f"- {label}: {answer}" for label, answer in added] + [""]
        scores = _headline(summary)
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
    if math.isnan(mean):
        return "-"
    return f"{mean:.2f} ± {spread:.2f}" if "nll" in score else f"{mean:.3g} ± {spread:.2g}"
