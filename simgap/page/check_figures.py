"""Pictures of a check of recordings, as SVG in bytes; equal content makes equal bytes."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from simgap.page.marks import COLOURS, INK
from simgap.page.svg import STYLE, svg
from simgap.types import Field, Recording, Schema

_WIDTH, _COLUMNS, _POINTS, _SESSIONS = 10.0, 3, 2000, 8
_TWO = (COLOURS["augmented"], COLOURS["nominal"])


def intervals(recordings: Sequence[Recording], time_step: float) -> bytes:
    """The interval before every row [s], sessions one after another; the simulator's step as a line.

    For every session, it shows some rows and the longest interval. The more sessions, the fewer rows of each.
    """
    points = max(2, _POINTS * _SESSIONS // max(len(recordings), _SESSIONS))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(_WIDTH, 2.4), layout="constrained")
        ax = figure.add_subplot()
        first, low, high = 0, time_step / 2, time_step * 2
        drawn: tuple[list[Any], list[Any]] = ([], [])
        for i, recording in enumerate(recordings):
            dt = np.diff(recording.time_s)
            rows = np.arange(first, first + len(dt))
            shown = np.unique([*np.linspace(0, len(dt) - 1, points).astype(int), dt.argmax()])
            drawn[i % 2].append((rows[shown], dt[shown]))
            first, low, high = first + len(dt), min(low, dt.min()), max(high, dt.max())
        for color, parts in zip(_TWO, drawn, strict=True):
            if parts:
                ax.plot(*np.concatenate(parts, axis=1), ".", markersize=2, color=color)
        ax.axhline(time_step, color=INK, linewidth=0.8)
        ax.set(xlabel="row, session after session", ylabel="interval [s]", yscale="log", ylim=(low / 1.1, high * 1.1))
        ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        ax.yaxis.set_minor_formatter(StrMethodFormatter("{x:.2g}") if high < 10 * low else NullFormatter())
        return svg(figure)


def columns(recording: Recording, schema: Schema) -> bytes:
    """Every column of a session over time."""
    series = [
        *zip(schema.state, recording.state.T, strict=True),
        *zip(schema.command, recording.command.T, strict=True),
    ]
    with matplotlib.rc_context(STYLE):
        lines = -(-len(series) // _COLUMNS)
        figure = Figure(figsize=(_WIDTH, 1.3 * lines + 0.3), layout="constrained")
        axes = figure.subplots(lines, _COLUMNS, squeeze=False, sharex=True)
        for ax, (field, values) in zip(axes.flat, series, strict=False):
            _series(ax, recording, field, values, field in schema.command)
        for ax in axes.flat[len(series) :]:
            ax.set_visible(False)
        for ax in axes[-1]:
            ax.set_xlabel("time [s]")
        return svg(figure)


def _series(ax: Axes, recording: Recording, field: Field, values: np.ndarray, command: bool) -> None:
    every = max(1, len(values) // _POINTS)
    style = {"drawstyle": "steps-post", "color": COLOURS["refitted"]} if command else {"color": COLOURS["augmented"]}
    ax.plot(recording.time_s[::every], values[::every], linewidth=0.8, **style)  # type: ignore[arg-type]
    ax.set_title(f"{field.name} [{field.unit}]")
