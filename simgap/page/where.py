"""View of where the mismatch is."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from simgap.page import numbers
from simgap.page.figures import Figures, source
from simgap.page.marks import ink, shade

Values = Mapping[str, Any]

_INTERVALS = 8  # listed at most
_INPUTS = 3  # that the mismatch depends on, listed at most
_UPRIGHT = 9  # regimes from which on their labels stand upright


def where(statement: Values, figures: Figures) -> dict[str, Any]:
    """Outputs, regimes and times by excess error, largest first; `figures` has the heat table and the strips."""
    located = statement.get("located") or {}
    outputs = sorted(located.get("outputs") or [], key=lambda o: -o["excess"])
    regimes = sorted(located.get("regimes") or [], key=lambda r: -r["share"])
    intervals = sorted(located.get("intervals") or [], key=lambda i: -(i.get("share") or 0))
    return {
        "outputs": [{"name": o["name"]} | _share(o["excess"]) for o in outputs],
        "regimes": [_regime(r) for r in regimes],
        "depends_on": [d["input"] for d in (located.get("depends_on") or [])[:_INPUTS]],
        "stretches": numbers.count(len(intervals), "interval") if intervals else "",
        "intervals": [_interval(i) for i in intervals[:_INTERVALS]],
        "more_intervals": max(len(intervals) - _INTERVALS, 0),
        "heat": _heat(figures.heat) if figures.heat else None,
        "strips": figures.strips and {"src": source(figures.strips["svg"]), "ramp": _ramp(figures.strips["top"])},
    }  # fmt: skip


def _regime(regime: Values) -> dict[str, Any]:
    rows = regime.get("rows")
    return {
        "name": regime["regime"],
        **_share(regime["share"]),
        "rows": _share(rows),
        "rows_known": numbers.known(rows),
    }


def _share(share: Any) -> dict[str, str]:
    return {"share": numbers.percent(share), "width": numbers.width(share)}


def _interval(interval: Values) -> str:
    share = f" ({numbers.percent(interval['share'])} of all excess)" if numbers.known(interval.get("share")) else ""
    ends = (numbers.fixed(interval[key], 1) for key in ("from_s", "to_s"))
    return f"{interval['session']}, {' to '.join(ends)} s{share}"


def _heat(heat: Values) -> dict[str, Any]:
    rows: Sequence[Sequence[float]] = heat["values"]
    return {
        "regimes": heat["regimes"], "upright": len(heat["regimes"]) > _UPRIGHT, "ramp": _ramp(heat["top"]),
        "rows": [{"name": name, "cells": [_cell(float(v), heat["top"]) for v in row]}
                 for name, row in zip(heat["outputs"], rows, strict=True)],
    }  # fmt: skip


def _cell(value: float, top: float) -> dict[str, str] | None:
    if not math.isfinite(value):
        return None
    return {
        "value": numbers.fixed(value, 2 if top >= 0.2 else 3),
        "colour": shade(value / top),
        "ink": ink(value / top),
    }


def _ramp(top: float) -> dict[str, str]:
    return {"stops": ", ".join(shade(k / 8) for k in range(9)), "top": numbers.number(top, 2)}
