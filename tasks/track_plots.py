"""Figures of tracking: errors against N, realised trajectories over their reference, an animation."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure

from simgap.policies.follow import Run
from tasks.plots import LABELS, STYLE, save, seeds_and_spread

Runs = Mapping[tuple[str, int, int], Run]
"""Runs by model, N and seed."""
_AXES = {"ellipse": (0, 1), "helix": (1, 2)}
"""Coordinates in which a shape is seen flat: from above, and from behind."""
_NAMES = "xyz"
_MARGIN = 0.35
"""What a flat panel shows about the reference [m]."""


def error_against_n(path: Path, rows: Sequence[dict[str, Any]], best: Mapping[str, float], dpi: int) -> None:
    """A panel per shape: mean over seeds of the mean error with its spread, every seed a dot, crossed where stopped.

    `best`: by shape, the error of the best proportional controller that was not stopped.
    """
    shapes = list(dict.fromkeys(r["shape"] for r in rows))
    figure, axes = plt.subplots(1, len(shapes), figsize=(5.2 * len(shapes), 4.0), squeeze=False, layout="constrained")
    for ax, shape in zip(axes[0], shapes, strict=True):
        chosen = [{**r, "model": r["policy"]} for r in rows if r["shape"] == shape]
        seeds_and_spread(ax, chosen, "mean_error")
        stopped = [r for r in chosen if r["stopped"]]
        ax.plot([r["sample_size"] for r in stopped], [r["mean_error"] for r in stopped], "x", color="black", ms=8,
                zorder=10, label="stopped early")  # fmt: skip
        if shape in best:
            ax.axhline(best[shape], color="black", ls=":", lw=1.2, label="best proportional controller")
        ax.set(xlabel="transitions N", ylabel="mean distance from the goal [m]", title=shape)
        ax.set_ylim(bottom=0.0)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False,
                  fontsize="small")  # fmt: skip
    save(figure, path, dpi)


def trajectories(path: Path, runs: Runs, shape: str, dpi: int) -> None:
    """A panel per model and N: what the hand did, every seed a line, over its reference, where the shape is flat."""
    models, sizes, figure, axes = _grid(runs, space=False)
    i, j = _AXES[shape]
    for (model, n, _), run in sorted(runs.items()):
        ax = axes[models.index(model), sizes.index(n)]
        ax.plot(run.states[:, 6 + i], run.states[:, 6 + j], color=STYLE[model][0], lw=0.9, alpha=0.8)
        if run.stopped:
            ax.plot(*run.states[-1:, [6 + i, 6 + j]].T, "x", color="black", ms=6)
    reference = max((run.goals for run in runs.values()), key=len)
    low, high = reference.min(0) - _MARGIN, reference.max(0) + _MARGIN
    for ax in axes.flat:
        ax.plot(reference[:, i], reference[:, j], color="black", lw=1.2, ls="--")
        # A run gone astray would make all others small.
        ax.set(xlim=(low[i], high[i]), ylim=(low[j], high[j]), aspect="equal")
        ax.grid(alpha=0.25)
    for ax in axes[-1]:
        ax.set_xlabel(f"{_NAMES[i]} [m]")
    for ax, model in zip(axes[:, 0], models, strict=True):
        ax.set_ylabel(f"{LABELS[model]}\n{_NAMES[j]} [m]")
    title = f"{shape}: the hand (a line a seed) and its reference (dashed); x: stopped early"
    figure.suptitle(title, fontsize="medium")
    save(figure, path, dpi)


def trajectories_3d(path: Path, runs: Runs, shape: str, dpi: int) -> None:
    """The same in space."""
    models, sizes, figure, axes = _grid(runs, space=True)
    for (model, n, _), run in sorted(runs.items()):
        ax = axes[models.index(model), sizes.index(n)]
        ax.plot(*run.states[:, 6:9].T, color=STYLE[model][0], lw=0.8, alpha=0.8)
        if run.stopped:
            ax.plot(*run.states[-1:, 6:9].T, "x", color="black", ms=5)
    reference = max((run.goals for run in runs.values()), key=len)
    for ax in axes.flat:
        ax.plot(*reference.T, color="black", lw=1.0, ls="--")
        ax.set_box_aspect(np.maximum(np.ptp(reference, axis=0), 0.3))
        ax.tick_params(labelsize=5, pad=-3)
        ax.locator_params(nbins=4)
    for ax, model in zip(axes[:, 0], models, strict=True):
        ax.text2D(-0.08, 0.5, LABELS[model], transform=ax.transAxes, rotation=90, va="center", fontsize=9)
    figure.suptitle(f"{shape} in space [m]: the hand (a line a seed) and its reference (dashed)", fontsize="medium")
    save(figure, path, dpi)


def animate(path: Path, run: Run, title: str) -> None:
    """A GIF of a run, from above and from the side: base, arm, the hand's trail, the goal."""
    figure, axes = plt.subplots(2, 1, figsize=(7.0, 5.0), layout="constrained")
    figure.suptitle(title, fontsize="medium")
    drawn = []
    for ax, (i, j) in zip(axes, ((0, 1), (0, 2)), strict=True):
        ax.plot(run.goals[:, i], run.goals[:, j], color="black", lw=0.8, ls="--")
        points = np.concatenate([run.goals, run.states[:, 6:9], np.pad(run.states[:, :2], ((0, 0), (0, 1)))])
        low, high = points.min(0)[[i, j]] - 0.35, points.max(0)[[i, j]] + 0.35
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel=f"{_NAMES[i]} [m]", ylabel=f"{_NAMES[j]} [m]")
        ax.set_aspect("equal")
        ax.grid(alpha=0.25)
        drawn.append((i, j, *ax.plot([], [], color="#888888", lw=6, solid_capstyle="round"),
                      *ax.plot([], [], color="#1f5fa8", lw=2), *ax.plot([], [], color="#1f5fa8", lw=0.9, alpha=0.7),
                      *ax.plot([], [], "o", color="#d1722d", ms=6)))  # fmt: skip

    def draw(t: int) -> list[Any]:
        x, y, yaw = run.states[t, :3]
        nose = 0.4 * np.array([np.cos(yaw), np.sin(yaw), 0.0])
        base = np.array([x, y, 0.5])
        body, hand, goal = np.stack([base - nose, base + nose]), run.states[t, 6:9], run.goals[t]
        arm = np.stack([base + 0.7 * nose, hand])
        for i, j, body_line, arm_line, trail, target in drawn:
            body_line.set_data(body[:, i], body[:, j])
            arm_line.set_data(arm[:, i], arm[:, j])
            trail.set_data(run.states[: t + 1, 6 + i], run.states[: t + 1, 6 + j])
            target.set_data([goal[i]], [goal[j]])
        return [artist for _, _, *artists in drawn for artist in artists]

    animation = FuncAnimation(figure, draw, frames=range(0, len(run.states), 4), blit=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    animation.save(path, PillowWriter(fps=8), dpi=50)
    plt.close(figure)


def _grid(runs: Runs, space: bool) -> tuple[list[str], list[int], Figure, np.ndarray]:
    """Models, sizes N, and a panel for each pair."""
    models = [model for model in LABELS if any(key[0] == model for key in runs)]
    sizes = sorted({n for _, n, _ in runs})
    size = (2.5 * len(sizes) + 0.6, 2.4 * len(models) + 0.5)
    figure, axes = plt.subplots(
        len(models), len(sizes), figsize=size, squeeze=False, layout="constrained",
        sharex=not space, sharey=not space, subplot_kw={"projection": "3d"} if space else {},
    )  # fmt: skip
    for ax, n in zip(axes[0], sizes, strict=True):
        ax.set_title(f"N = {n}", fontsize="medium")
    return models, sizes, figure, axes
