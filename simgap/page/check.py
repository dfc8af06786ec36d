"""What a folder of recordings holds and what looks wrong in it, as a page for people: one HTML file, self-contained."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

from simgap import findings
from simgap.findings import Survey
from simgap.formats.documents import write_text
from simgap.formats.recordings import read_recordings
from simgap.page import check_figures as plots
from simgap.survey import Column, Rate
from simgap.types import Recording, Schema, StepModel

PAGE = "check.html"
LISTED = 200
"""Most sessions, and most files left out, that the page lists one by one."""


class Checked(NamedTuple):
    """Sessions, why others are left out, the survey of the sessions, and what looks wrong in them."""

    sessions: list[Recording]
    left_out: list[str]
    survey: Survey
    findings: list[str]


def check(folder: Path, simulator: StepModel) -> Checked:
    """Read every session under the folder and survey them; RecordingError where none can be used."""
    schema = simulator.schema
    sessions, errors = read_recordings(folder, schema, simulator.time_step)
    survey = findings.look(schema, sessions)
    said = findings.findings(schema, simulator.time_step, survey)
    return Checked(sessions, [str(e) for e in errors], survey, said)


def write(folder: Path, name: str, checked: Checked, simulator: StepModel) -> Path:
    """The page, in `folder`; returns its path."""
    path = folder / PAGE
    write_text(path, page(name, checked, simulator))
    return path


def page(name: str, checked: Checked, simulator: StepModel) -> str:
    """The whole document. `name`: the recordings'."""
    schema, sessions = simulator.schema, checked.sessions
    rows, seconds = sum(len(r.time_s) for r in sessions), sum(float(r.time_s[-1] - r.time_s[0]) for r in sessions)
    longest = max(sessions, key=lambda r: len(r.time_s))
    survey, shown = checked.survey, _shown(checked)
    parts = [
        f"<h1>Check of {escape(name)}</h1>",
        f"<p class='facts'>{len(sessions)} sessions, {rows:,} rows, {seconds / 60:.1f} min; "
        f"{len(checked.left_out)} left out</p>",
        "<h2>What looks wrong</h2>",
        _list(checked.findings) if checked.findings else "<p>Nothing that these checks see.</p>",
        f"<h2>Left out</h2>{_list(checked.left_out[:LISTED])}" if checked.left_out else "",
        _more(len(checked.left_out) - LISTED, "files are left out and not listed; `simgap check` prints them all."),
        "<h2>Sessions</h2>",
        _picture(plots.intervals(sessions, simulator.time_step), "The interval before every row; the line is the "
                 "simulator's step."),
        _table(("session", "rows", "length [s]", "rate [Hz]", "interval, 5 % to 95 % [s]", "stalls", "longest [s]"),
               [(r.name, f"{len(r.time_s):,}", f"{r.time_s[-1] - r.time_s[0]:.1f}", f"{1 / q.median_s:.2f}",
                 f"{q.low_s:.4g} to {q.high_s:.4g}", f"{q.stalls:.1%}", f"{q.longest_s:.3g} (row {q.longest_row})")
                for r, q in shown]),
        _more(len(sessions) - LISTED, "sessions are not in this table: those whose intervals are the most even. They "
              "are part of all else on this page."),
        "<h2>Columns</h2>",
        _table(("column", "unit", "least", "greatest", "std", "repeats", "jumps"), _columns(schema, survey.columns)),
        _picture(plots.columns(longest, schema), f"{longest.name}, the longest session."),
        "<h2>Do velocities go with positions?</h2>",
        "<p>Slope and correlation of the change of a position on its velocity, about zero; both are 1 where units, "
        "frames and stamps are right.</p>",
        _table(("velocity", "position", "slope", "correlation"),
               [(n, k.position, f"{k.slope:.3f}", f"{k.correlation:.3f}") for n, k in survey.kinematics.items()]),
        "<h2>What the commands do</h2>",
        "<p>An effect can be learnt where its command moves, apart from the other commands.</p>",
        "<p>The machine takes no commands.</p>" if not schema.command else
        _table(("command", "moves", "changes", "least", "greatest", "nine tenths of its power below [Hz]", "most like"),
               [(n, f"{e.moving:.0%}", f"{e.changes:.0%}", f"{e.low:.3g}", f"{e.high:.3g}", f"{e.band_hz:.2f}",
                 f"{e.like} ({e.correlation:+.2f})" if e.like else "-") for n, e in survey.excitation.items()]),
    ]  # fmt: skip
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Check of {escape(name)}</title>'
        f"<style>{_CSS}</style></head>\n<body><main>{''.join(parts)}</main></body></html>\n"
    )


def _shown(checked: Checked) -> list[tuple[Recording, Rate]]:
    """The sessions of the table; where there are too many, those with the longest intervals in medians."""
    every = list(zip(checked.sessions, checked.survey.rates.values(), strict=True))
    uneven = sorted(range(len(every)), key=lambda i: every[i][1].median_s / every[i][1].longest_s)[:LISTED]
    return [every[i] for i in sorted(uneven)]


def _more(count: int, what: str) -> str:
    return f"<p class='facts'>{count:,} more {escape(what)}</p>" if count > 0 else ""


def _columns(schema: Schema, columns: Mapping[str, Column]) -> list[tuple[Any, ...]]:
    units = {f.name: f.unit for f in (*schema.state, *schema.command)}
    return [
        (n, units[n], f"{c.low:.4g}", f"{c.high:.4g}", f"{c.std:.3g}", f"{c.repeated:.0%}", len(c.jumps) or "")
        for n, c in columns.items()
    ]


def _list(lines: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    head = "".join(f"<th>{escape(h)}</th>" for h in header)
    body = "".join("<tr>" + "".join(f"<td>{escape(str(v))}</td>" for v in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _picture(svg: bytes, caption: str) -> str:
    data = f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"
    return f'<figure><figcaption>{escape(caption)}</figcaption><img alt="" src="{data}"></figure>'


_CSS = """
body { margin: 0; background: #f3f4f6; color: #1c2430; font: 15px/1.5 system-ui, sans-serif; }
main { max-width: 1040px; margin: 24px auto; padding: 30px 40px; background: #fff; border-radius: 12px; }
h1 { font-size: 24px; margin: 0; } h2 { font-size: 19px; margin: 30px 0 8px; }
p, li { max-width: 860px; overflow-wrap: anywhere; } .facts, figcaption { color: #6b7280; font-size: 13.5px; }
table { border-collapse: collapse; font-size: 13px; width: 100%; } th { text-align: left; font-weight: 600; }
td, th { padding: 3px 10px 3px 0; border-bottom: 1px solid #eceef1; overflow-wrap: anywhere; }
figure { margin: 14px 0; } img { max-width: 100%; display: block; }
"""
