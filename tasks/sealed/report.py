"""A sealed suite's report: scores with goals, failures first, every case."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from tasks.sealed import metrics
from tasks.sealed.judge import Row
from tasks.sealed.metrics import Score

SHOWN = ("case", "kind", "truth", "strength", "size", "noise", "verdict", "answer", "probability", "fault", "open_loop",
         "seconds")  # fmt: skip
"""Of every case, as far as its suite knows it."""


def markdown(
    about: Mapping[str, Any], rows: Sequence[Row], scores: Sequence[Score], baselines: Sequence[Mapping[str, Any]],
    failed: Sequence[Row], pictures: Mapping[str, str],
) -> str:  # fmt: skip
    """The report. about: what was examined, in words; pictures: of failures, by case."""
    shown = [name for name in SHOWN if any(name in row for row in rows)]
    lines = [f"# Sealed suite: {about['suite']}", ""]
    lines += [f"- {name}: {value}" for name, value in about.items() if name != "suite"]
    lines += [
        "",
        "Strength is what the true form could gain on held-out sessions, in nats (docs/explanation/proof.md).",
        "",
    ]
    lines += [f"## Failures: {len(failed)} of {len(rows)} cases", ""]
    counts = {fault: sum(r["fault"] == fault for r in failed) for fault in metrics.FAULTS}
    lines += [f"- {fault}: {count}" for fault, count in counts.items() if count]
    lines += ["", *_rows(failed, shown), ""]
    lines += [f"![{case}]({picture})" for case, picture in pictures.items()]
    lines += [
        "",
        "## Scores",
        "",
        "| score | value | 95 % interval | cases | goal |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [f"| {s.name} | {_number(s.value)} | {_interval(s)} | {s.n} | {s.goal} |" for s in scores]
    lines += ["", "![power](power.png)", "", "![confusion](confusion.png)", "", "![reliability](reliability.png)", ""]
    lines += ["## By effect and strength", "", *_by_effect(rows), ""]
    lines += ["## Other methods on the same cases", "", *_rows(baselines, tuple(baselines[0]) if baselines else ()), ""]
    lines += [
        "## Every case",
        "",
        *_rows(sorted(rows, key=lambda r: (r["kind"], r["truth"], r["strength"])), shown),
        "",
    ]
    return "\n".join(lines)


def _number(value: Any) -> str:
    if isinstance(value, float):
        return "-" if math.isnan(value) else f"{value:.3g}"
    return "-" if value is None or value == "" else str(value)


def _interval(score: Score) -> str:
    return "-" if math.isnan(score.low) else f"{score.low:.3g} to {score.high:.3g}"


def _rows(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[str]:
    if not rows:
        return ["None."]
    head = [f"| {' | '.join(n.replace('_', ' ') for n in names)} |", f"|{' --- |' * len(names)}"]
    return head + [f"| {' | '.join(_number(row.get(n)) for n in names)} |" for row in rows]


def _by_effect(rows: Sequence[Row]) -> list[str]:
    """Hits of cases by effect, in columns of strength; an effect that is easily found stands high."""
    singles = [r for r in rows if r["kind"] in ("single", "duel")]
    heads = [f"{low:.0f} nats" for low, _ in metrics.BINS]
    table = []
    for effect in sorted({r["truth"] for r in singles}):
        mine = [r for r in singles if r["truth"] == effect]
        cells: dict[str, Any] = {"effect": effect}
        for head, (low, high) in zip(heads, metrics.BINS, strict=True):
            found = [r for r in mine if low <= r["strength"] < high]
            cells[f"from {head}"] = f"{sum(r['top1'] for r in found)} of {len(found)}" if found else ""
        table.append(cells)
    return _rows(table, tuple(table[0]) if table else ())
