"""The page of a check: what a folder of recordings holds and what looks wrong in it. One self-contained HTML file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from simgap import findings
from simgap.engines import Engine
from simgap.findings import Survey
from simgap.formats.documents import write_text
from simgap.formats.recordings import read_recordings
from simgap.page import check_figures, numbers, render
from simgap.page.figures import source
from simgap.survey import Column, Rate
from simgap.types import Recording, Schema, StepModel

PAGE = "check.html"
LISTED = 200
"""Maximum number of sessions, and of left-out files, that the page lists."""


class Checked(NamedTuple):
    """Sessions, why files are left out, the survey of the sessions, and what looks wrong in them."""

    sessions: list[Recording]
    left_out: list[str]
    survey: Survey
    findings: list[str]


def check(folder: Path, simulator: StepModel | Engine) -> Checked:
    """Read and survey every session under the folder. Raises RecordingError if none can be used."""
    schema = simulator.schema.measured
    sessions, errors = read_recordings(folder, schema, simulator.time_step)
    survey = findings.look(schema, sessions)
    lines = findings.findings(schema, simulator.time_step, survey)
    return Checked(sessions, [str(e) for e in errors], survey, lines)


def write(folder: Path, name: str, checked: Checked, simulator: StepModel | Engine) -> Path:
    """Write the page into `folder`; returns its path."""
    path = folder / PAGE
    write_text(path, page(name, checked, simulator))
    return path


def page(name: str, checked: Checked, simulator: StepModel | Engine) -> str:
    """The whole document; `name` is that of the recordings."""
    schema, sessions, survey = simulator.schema.measured, checked.sessions, checked.survey
    rows, seconds = sum(len(r.time_s) for r in sessions), sum(float(r.time_s[-1] - r.time_s[0]) for r in sessions)
    longest = max(sessions, key=lambda r: len(r.time_s))
    count = len(checked.findings)
    return render.fill("check.html.jinja", {
        "name": name,
        "facts": f"{numbers.count(len(sessions), 'session')}, {rows:,} rows, {numbers.duration(seconds)}; "
                 f"{numbers.count(len(checked.left_out), 'file')} left out",
        "badge": numbers.count(count, "finding") if count else "No findings",
        "headline": f"{numbers.count(count, 'thing')} to look at before a diagnosis" if count else
                    "These checks found nothing wrong with the recordings",
        "findings": checked.findings,
        "left_out": checked.left_out[:LISTED],
        "more_left_out": _beyond(len(checked.left_out)),
        "intervals": source(check_figures.intervals(sessions, simulator.time_step)),
        "sessions": [(r.name, f"{len(r.time_s):,}", f"{r.time_s[-1] - r.time_s[0]:.1f}", f"{1 / q.median_s:.2f}",
                      f"{q.low_s:.4g} to {q.high_s:.4g}", f"{q.stalls:.1%}", f"{q.longest_s:.3g} (row {q.longest_row})")
                     for r, q in _shown(checked)],
        "more_sessions": _beyond(len(sessions)),
        "columns": _columns(schema, survey.columns),
        "longest": longest.name,
        "series": source(check_figures.columns(longest, schema)),
        "kinematics": [(n, k.position, f"{k.slope:.3f}", f"{k.correlation:.3f}") for n, k in survey.kinematics.items()],
        "excitation": [(n, f"{e.moving:.0%}", f"{e.changes:.0%}", f"{e.low:.3g}", f"{e.high:.3g}", f"{e.band_hz:.2f}",
                        f"{e.like} ({e.correlation:+.2f})" if e.like else "-") for n, e in survey.excitation.items()],
    })  # fmt: skip


def _beyond(count: int) -> str:
    """Number of entries that are not listed; empty for none."""
    return f"{count - LISTED:,}" if count > LISTED else ""


def _shown(checked: Checked) -> list[tuple[Recording, Rate]]:
    """The sessions of the table; if there are too many, those with the longest interval relative to the median."""
    every = list(zip(checked.sessions, checked.survey.rates.values(), strict=True))
    uneven = sorted(range(len(every)), key=lambda i: every[i][1].median_s / every[i][1].longest_s)[:LISTED]
    return [every[i] for i in sorted(uneven)]


def _columns(schema: Schema, columns: Mapping[str, Column]) -> list[tuple[Any, ...]]:
    units = {f.name: f.unit for f in (*schema.state, *schema.command)}
    return [
        (n, units[n], f"{c.low:.4g}", f"{c.high:.4g}", f"{c.std:.3g}", f"{c.repeated:.0%}", len(c.jumps) or "")
        for n, c in columns.items()
    ]
