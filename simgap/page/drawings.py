"""Pictures of a diagnosis, as SVG in bytes.

Equal content makes equal bytes. A figure's inch is 96 pixels of the page, which is 10 inches wide.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from simgap.page.marks import COLOURS, EXCESS, GREY, HELDOUT, INK
from simgap.page.svg import STYLE, svg

Values = Mapping[str, Any]

_EXCESS = LinearSegmentedColormap.from_list("excess", EXCESS, bad="#e3e5e9")
_LINES = {"nominal": ("-", 1.3), "refitted": ("-", 1.3), "augmented": ("-", 1.6), "black_box": ((0, (3, 3)), 1.3)}
_WIDTH = 10.0  # of the page [inch]
_COLUMNS = 3
_DOTS = 120  # measured points that a panel shows
_NAME_SHOWN = 30  # characters of a session's name next to its strip
_OVERSHOOT = 0.8  # how far a panel follows diverging predictions, in spans of what was measured


def top_of_scale(values: Sequence[Any], floor: float) -> float:
    """Top of the colour scale of excess [nats a row]: 99th percentile (outliers do not count), at least `floor`."""
    flat = np.concatenate([np.zeros(1), *(np.ravel(_numbers(v)) for v in values)])
    return max(float(np.nanpercentile(flat, 99)), floor)


@matplotlib.rc_context(STYLE)
def strips(sessions: Sequence[Values], intervals: Sequence[Values], top: float) -> bytes:
    """A strip per session, time [s] along x, colour its excess [nats a row] up to `top`; located intervals framed."""
    groups = [("Training sessions", False, GREY), ("Held-out sessions", True, HELDOUT)]
    rows = [(title, colour, [s for s in sessions if bool(s["heldout"]) == held]) for title, held, colour in groups]
    rows = [row for row in rows if row[2]]
    lines = sum(len(members) for _, _, members in rows) + 0.9 * len(rows)
    figure = Figure(figsize=(_WIDTH, 0.27 * lines + 0.5), layout="constrained")
    ax = figure.add_subplot()
    y, ticks = 0.0, {}
    for title, colour, members in rows:
        ax.text(0, y + 0.5, title, transform=ax.get_yaxis_transform(), color=colour, weight="bold", va="center")
        y += 0.9
        for strip in members:
            ticks[y + 0.5] = (_shortened(str(strip["session"])), colour)
            _strip(ax, strip, [i for i in intervals if i["session"] == strip["session"]], y, top)
            y += 1
    ax.set(ylim=(y, 0), xlabel="time [s]")
    ax.set_yticks(list(ticks), [name for name, _ in ticks.values()])
    for label, (_, colour) in zip(ax.get_yticklabels(), ticks.values(), strict=True):
        label.set_color(colour)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    return svg(figure)


def _strip(ax: Axes, strip: Values, intervals: Sequence[Values], y: float, top: float) -> None:
    time, excess = _numbers(strip["time_s"]), _numbers(strip["excess"])
    if not len(time):
        return
    middles = (time[1:] + time[:-1]) / 2
    first, last = (time[0], time[-1]) if len(time) > 1 else (time[0] - 0.5, time[0] + 0.5)
    edges = np.concatenate([[first], middles, [last]])
    cells = np.ma.masked_invalid(excess)[None]
    ax.pcolormesh(edges, [y + 0.14, y + 0.86], cells, cmap=_EXCESS, vmin=0, vmax=top, rasterized=True)
    for interval in intervals:
        corner, width = (interval["from_s"], y + 0.06), interval["to_s"] - interval["from_s"]
        ax.add_patch(Rectangle(corner, width, 0.88, fill=False, edgecolor=INK, lw=1.3, zorder=3))


@matplotlib.rc_context(STYLE)
def law(fitted: Values) -> bytes:
    """The law of an effect as a line, and the data that it explains as dots with error bars."""
    figure = Figure(figsize=(4.5, 2.7), layout="constrained")
    ax = figure.add_subplot()
    x, y = _numbers(fitted["x"]), _numbers(fitted["y"])
    error = fitted.get("y_err")
    ax.errorbar(x, y, None if error is None else _numbers(error), fmt="o", color=INK, ecolor="#a9afb8", ms=3.5, lw=1)
    ax.plot(_numbers(fitted["line_x"]), _numbers(fitted["line_y"]), color=COLOURS["augmented"], lw=2, zorder=3)
    ax.set(xlabel=str(fitted["x_label"]), ylabel=str(fitted["y_label"]))
    if fitted.get("y_scale") == "log":
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
    ax.grid(True)
    return svg(figure)


@matplotlib.rc_context(STYLE)
def rollouts(panels: Sequence[Values]) -> bytes:
    """A panel per output of one session, over time [s]: measurements as dots, a line per model."""
    columns = min(_COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(_WIDTH, 1.55 * rows + 0.25), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for ax, panel in zip(axes, panels, strict=False):
        _rollout(ax, panel)
    for ax in axes[len(panels) :]:
        ax.set_visible(False)
    for ax in axes[max(0, len(panels) - columns) : len(panels)]:
        ax.tick_params(labelbottom=True)
    figure.supxlabel("time [s]", fontsize=STYLE["font.size"], color=GREY)
    return svg(figure)


def _rollout(ax: Axes, panel: Values) -> None:
    time, measured = _numbers(panel["time_s"]), _numbers(panel["measured"])
    shown = slice(None, None, max(1, math.ceil(len(time) / _DOTS)))
    ax.plot(time[shown], measured[shown], ".", color=INK, ms=4.5, mew=0, alpha=0.75)
    extent = [measured]
    for model, (style, width) in _LINES.items():
        if panel.get(model) is not None:
            line = _broken(_numbers(panel[model]), panel["unit"])
            ax.plot(time, line, color=COLOURS[model], ls=style, lw=width)
            extent.append(line)
    low, high = _limits(measured, np.concatenate(extent))
    ax.set_ylim(low, high)
    ax.set_title(f"{panel['output']} [{panel['unit']}]")
    ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    ax.grid(True)


def _broken(line: Float[np.ndarray, " T"], unit: str) -> Float[np.ndarray, " T"]:
    """An angle's line, without the strokes across the panel where the angle wraps."""
    if unit != "rad" or len(line) < 2:
        return line
    return np.where(np.abs(np.diff(line, prepend=line[0])) > np.pi, np.nan, line)


def _limits(measured: Float[np.ndarray, " T"], drawn: Float[np.ndarray, " k"]) -> tuple[float, float]:
    """Limits of a panel: the range of everything drawn, except what is far outside the measured range."""
    measured, drawn = measured[np.isfinite(measured)], drawn[np.isfinite(drawn)]
    if not len(measured):
        return (0.0, 1.0)
    low, high = float(measured.min()), float(measured.max())
    span = high - low or abs(high) or 1.0
    low, high = max(float(drawn.min()), low - _OVERSHOOT * span), min(float(drawn.max()), high + _OVERSHOOT * span)
    margin = 0.06 * (high - low or span)
    return low - margin, high + margin


@matplotlib.rc_context(STYLE)
def commands(experiment: Values) -> bytes:
    """The commands of an experiment over time [s]: a row per channel that moves, each with its own scale."""
    time = _numbers(experiment["time_s"])
    moving = moving_channels(experiment)
    figure = Figure(figsize=(_WIDTH, 0.85 * len(moving) + 0.45), layout="constrained")
    axes = figure.subplots(len(moving), 1, squeeze=False, sharex=True).ravel()
    for ax, name in zip(axes, moving, strict=True):
        values = _numbers(experiment["channels"][name])
        ax.fill_between(time, values, step="post", color=COLOURS["augmented"], alpha=0.12, lw=0)
        ax.step(time, values, where="post", color=COLOURS["augmented"], lw=1.4)
        ax.axhline(0, color="#b9bec6", lw=0.8, zorder=0)
        ax.set_title(f"{name} [{experiment['units'].get(name, '-')}]")
        ax.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
        ax.margins(x=0, y=0.12)
        ax.grid(True)
    axes[-1].set_xlabel("time [s]")
    return svg(figure)


def moving_channels(experiment: Values) -> list[str]:
    """Channels with commands other than zero."""
    return [name for name, values in experiment["channels"].items() if np.any(_numbers(values) != 0)]


def _numbers(values: Any) -> Float[np.ndarray, " ..."]:
    return np.asarray(values, dtype=float)


def _shortened(name: str) -> str:
    return name if len(name) <= _NAME_SHOWN else f"…{name[1 - _NAME_SHOWN :]}"
