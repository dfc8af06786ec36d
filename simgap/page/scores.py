"""View of the held-out scores and of the simulator's parameters."""

import math
from collections.abc import Mapping
from typing import Any

from simgap.page import marks, numbers
from simgap.page.figures import Figures, source
from simgap.page.wording import metric

Values = Mapping[str, Any]

_ONE_TABLE = 6  # parameters; more are shown in two tables


def scores(statement: Values, figures: Figures) -> dict[str, Any]:
    """The share explained, a table of scores (a row per score, a column per model), and figures of forecasts."""
    fit, labels = statement.get("fit") or {}, marks.labels(statement)
    models, share = fit.get("models") or {}, fit.get("explained_share")
    sessions, ends = len(fit.get("heldout_sessions") or []), numbers.interval(fit.get("explained_share_ci95"))
    named = [m for m in marks.MODELS if models.get(m)]
    keys = list(dict.fromkeys(key for m in named for key in models[m]))
    rows = [_row(key, {m: models[m].get(key) for m in named}) for key in keys]
    return {
        "share": {
            "percent": numbers.percent(share), "width": numbers.width(share),
            "interval": f"{numbers.percent(ends[0])} to {numbers.percent(ends[1])}" if ends else "",
        } if statement.get("effects") and numbers.known(share) else None,
        "over": f"On {numbers.count(sessions, 'session')} not used for fitting" if sessions else "Held out",
        "any": bool(keys),
        "models": [_model(m, labels) for m in named],
        "rows": [row for row in rows if row],
        "replay": _replay(statement.get("replay") or {}, labels),
        "rollouts": [
            {"session": r["session"], "src": source(r["svg"]), "models": [_model(m, labels) for m in r["models"]]}
            for r in figures.rollouts
        ],
    }  # fmt: skip


def _replay(replay: Values, labels: Mapping[str, str]) -> dict[str, Any] | None:
    """Open-loop errors, a row per position in thousandths of its unit; None without any."""
    positions = replay.get("positions") or []
    named = [m for m in marks.MODELS if any(m in p["errors"] for p in positions)]
    if not named:
        return None
    return {
        "over": f"{numbers.count(replay['pieces'], 'piece')} of {numbers.number(replay['seconds'])} s",
        "models": [_model(m, labels) for m in named],
        "rows": [
            {"name": p["name"], "unit": f"m{p['unit']}",
             "cells": [numbers.number(1000 * p["errors"][m]) if numbers.known(p["errors"].get(m)) else numbers.DASH
                       for m in named]}
            for p in positions
        ],
    }  # fmt: skip


def _model(model: str, labels: Mapping[str, str]) -> dict[str, str]:
    return {"label": labels[model], "colour": marks.COLOURS[model]}


def _row(key: str, entries: Mapping[str, Values | None]) -> dict[str, Any] | None:
    """A score of all models; None where no model has it."""
    known = {m: e for m, e in entries.items() if e and numbers.known(e.get("value"))}
    if not known:
        return None
    best = min(e["value"] for e in known.values())
    places = max((numbers.decimals(e.get("ci95")) or 0 for e in known.values()), default=0) or None
    label, unit = metric(key)
    points = [(m, float(e["value"]), numbers.interval(e.get("ci95"))) for m, e in known.items()]
    return {
        "label": label, "unit": unit, "whiskers": marks.whiskers(points),
        "cells": [_cell(known.get(m), best, places) for m in entries],
    }  # fmt: skip


def _cell(entry: Values | None, best: float, places: int | None) -> dict[str, Any]:
    value, interval = numbers.with_interval(entry["value"], entry.get("ci95"), places) if entry else (numbers.DASH, "")
    return {"value": value, "interval": interval, "best": bool(entry) and entry["value"] == best}


def parameters(statement: Values) -> dict[str, Any]:
    """Every refitted parameter before and after, its shift in half widths of its interval, and its range."""
    given = statement.get("parameters") or {}
    after = {n: float(v) for n, v in (given.get("fitted") or {}).items() if numbers.known(v)}
    rows = [_parameter(name, value, given) for name, value in after.items()]
    split = math.ceil(len(rows) / 2) if len(rows) > _ONE_TABLE else len(rows)
    return {
        "of": numbers.count(len(rows), "parameter"), "any": bool(rows),
        "moved": sum(row["moved"] for row in rows),
        "tables": [t for t in (rows[:split], rows[split:]) if t],
        "patched": statement.get("patched"),
    }  # fmt: skip


def _parameter(name: str, after: float, given: Values) -> dict[str, Any]:
    def of(what: str) -> Any:
        return (given.get(what) or {}).get(name)

    before, ends, limits = of("nominal"), numbers.interval(of("ci95")), numbers.interval(of("ranges"))
    before = float(before) if numbers.known(before) else None
    value, interval = numbers.with_interval(after, ends)
    shift = _shift(before, after, ends)
    return {
        "name": name, "unit": numbers.unit(of("units")), "value": value, "interval": interval,
        "before": numbers.with_interval(before, ends)[0], "shift": numbers.signed(shift),
        "moved": abs(shift or 0) > 1, "bar": limits and marks.parameter(before, after, ends, limits),
    }  # fmt: skip


def _shift(before: float | None, after: float, ends: tuple[float, float] | None) -> float | None:
    if before is None or ends is None or ends[1] <= ends[0]:
        return None
    return (after - before) / ((ends[1] - ends[0]) / 2)
