"""Report of the stage `twin`: how far it can be trusted in place of the robot."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from prefect import task

from simgap.formats.documents import read_json, write_json, write_table, write_text
from simgap.robots.twin.score import BODIES, LEVEL
from tasks import plots
from tasks.tracking.runs import Run
from tasks.twin import BLACK_BOX, KNOWN, SIM_MODEL, UNKNOWN
from tasks.workspace import Workspace

Row = dict[str, Any]
LABELS = {
    KNOWN: "twin, durations of rows as recorded",
    UNKNOWN: "twin, all rows of the mean duration",
    SIM_MODEL: "SIM-MODEL",
    BLACK_BOX: "FSVGD, a black box",
}
METRICS = "metrics.json"
_NAMES = {"base": "base", "ee": "hand"}


@task(task_run_name="report-twin-{workspace.source}")
def write(workspace: Workspace, rows: Sequence[Row], dpi: int) -> list[Row]:
    """Table, metrics, figure and the written report; returns the means over folds, a row for every way to predict."""
    folder, summary = workspace.twin_report, summarise(rows)
    write_table(folder / "folds.csv", [{**dict.fromkeys(_scores(rows), ""), **r} for r in rows])
    write_json(folder / METRICS, {r["model"]: {k: v for k, v in r.items() if _wanted(k, rows)} for r in summary})
    curves = {LABELS[r["model"]]: {body: [r[f"rollout_{body}_{h}"] for h in _horizons(rows)] for body in BODIES}
              for r in summary}  # fmt: skip
    plots.against_rows(folder / "error_against_rows.png", _horizons(rows), curves, _NAMES, dpi)
    write_text(folder / "report.md", _markdown(workspace, rows, summary))
    return summary


@task(task_run_name="log-twin-{workspace.source}", retries=1)
def log(run: Run, workspace: Workspace, summary: Sequence[Row]) -> None:
    """The means over folds, the report and the twin's file."""
    run.scores({f"{row['model'].replace(',', '')}/{name}": value for row in summary for name, value in row.items()
                if name != "model"})  # fmt: skip
    for path in (*sorted(workspace.twin_report.glob("*")), workspace.twin):
        run.artifact(path)


def summarise(rows: Sequence[Row]) -> list[Row]:
    """Means over folds of every score that a way to predict has."""
    found: list[Row] = []
    for model in LABELS:
        own = [r for r in rows if r["model"] == model]
        found.append({"model": model, **{name: float(np.mean([r[name] for r in own]))
                                         for name in _scores(rows) if name in own[0]}})  # fmt: skip
    return found


def _scores(rows: Sequence[Row]) -> list[str]:
    names = dict.fromkeys(name for row in rows for name in row)
    return [name for name in names if name.startswith(("rollout_", "coverage_"))]


def _horizons(rows: Sequence[Row]) -> list[int]:
    return sorted({int(name.rsplit("_", 1)[1]) for name in _scores(rows) if name.startswith("rollout_")})


def _wanted(name: str, rows: Sequence[Row]) -> bool:
    """Of the metrics: what is shown in the table."""
    shown = {f"rollout_{body}_{h}" for body in BODIES for h in _shown(rows)}
    return name in shown or name.startswith("coverage_")


def _shown(rows: Sequence[Row]) -> list[int]:
    """Ten rows and the longest, or the longest alone."""
    horizons = _horizons(rows)
    return [h for h in horizons if h in (10, horizons[-1])]


def _markdown(workspace: Workspace, rows: Sequence[Row], summary: Sequence[Row]) -> str:
    record, by_name = read_json(workspace.twin_record), {r["model"]: r for r in summary}
    folds, shown = len({r["fold"] for r in rows}), _shown(rows)
    longest = shown[-1]
    twin, kinematic = by_name[UNKNOWN], by_name[SIM_MODEL]
    head = [f"{_NAMES[body]}, {h} rows" for body in BODIES for h in shown]
    lines = [
        f"# A twin of the recorded robot: {workspace.source}",
        "",
        f"After {longest} rows the twin's hand is {twin[f'rollout_ee_{longest}']:.2f} m from where it was measured, "
        f"SIM-MODEL's {kinematic[f'rollout_ee_{longest}']:.2f} m: means over {folds} folds of sessions that took no "
        "part in the fit.",
        "",
        "![Error against rows](error_against_rows.png)",
        "",
        "Mean distance between predicted and measured position [m], from the measured state at the start and the "
        "commands sent, mean over folds (least to greatest fold). Durations as recorded are read from the measurements "
        "of the same rows: nobody knows them beforehand, and they absorb whatever else speeds up or slows down a row.",
        "",
        "| prediction by | " + " | ".join(head) + " |",
        "| --- |" + " --- |" * len(head),
    ]
    for row in summary:
        own = [r for r in rows if r["model"] == row["model"]]
        cells = []
        for name in (f"rollout_{body}_{h}" for body in BODIES for h in shown):
            each = [r[name] for r in own]
            cells.append(f"{row[name]:.3f} ({min(each):.3f} to {max(each):.3f})")
        lines.append(f"| {LABELS[row['model']]} | " + " | ".join(cells) + " |")
    inside = " and ".join(f"{twin[f'coverage_{body}_{longest}']:.0%} of the {_NAMES[body]}'s" for body in BODIES)
    lines += [
        "",
        f"A central {LEVEL:.0%} interval of runs with replayed departures holds {inside} positions, an axis at a time, "
        f"{longest} rows ahead. Below {LEVEL:.0%}, the twin strays less than the robot.",
        "",
        f"The twin of all {record['sessions']} sessions: effects "
        f"{', '.join(record['effects']) or 'none'}; measured positions older than velocities by "
        f"{record['ages_s'][0]:.3f} s (base) and {record['ages_s'][1]:.3f} s (hand); a row lasts {record['row_s']:.3f} "
        f"s on average, and {record['stalls']:.0%} of the rows are stalls.",
        "",
    ]
    return "\n".join(lines)
