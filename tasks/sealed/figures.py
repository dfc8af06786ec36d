"""Figures of a sealed suite: power, confusion, reliability, and a picture of every failure that is shown."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Float

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.colors import LogNorm

from tasks.plots import save
from tasks.sealed.judge import ONE

RIGHT, WRONG, NEITHER, GREY = "#1f5fa8", "#bf3021", "#e0b04c", "#9aa0a8"
_SMOOTH = 9  # rows over which a failure's excess is smoothed
_MOST = 8.0  # variances at which its colours end at least


def power(path: Path, bins: Sequence[Mapping[str, Any]], dpi: int) -> None:
    """Shares of effects that are named rightly, wrongly, or only said to be there, against their strength."""
    bins = [b for b in bins if b["n"]]
    figure, ax = plt.subplots(figsize=(6.2, 4.0), layout="constrained")
    x = np.arange(len(bins))
    right = np.array([b["right"] for b in bins])
    low, high = (np.array([b[k] for b in bins]) for k in ("low", "high"))
    ax.errorbar(x, right, np.maximum([right - low, high - right], 0), color=RIGHT, marker="o", lw=1.8, capsize=4,
                label="right name")  # fmt: skip
    ax.plot(x, [b["wrong"] for b in bins], color=WRONG, marker="s", lw=1.4, label="wrong name")
    ax.plot(x, [b["unexplained"] for b in bins], color=NEITHER, marker="^", lw=1.4, label="something, without a name")
    labels = [f"{b['from_nats']:.0f} to {b['to_nats']:.0f}" if np.isfinite(b["to_nats"]) else f"{b['from_nats']:.0f} up"
              for b in bins]  # fmt: skip
    ax.set_xticks(x, [f"{label}\n({b['n']})" for label, b in zip(labels, bins, strict=True)])
    ax.set(xlabel="strength [nats that the true form could gain held out] (cases)", ylabel="share of cases",
           ylim=(-0.03, 1.03), title="Single effects: what is named")  # fmt: skip
    ax.grid(alpha=0.25)
    ax.legend(frameon=False)
    save(figure, path, dpi)


def confusion(path: Path, rows: Sequence[Mapping[str, Any]], least: float, dpi: int) -> None:
    """Confusion matrix of single effects of at least `least` nats: the true one, and the first that is named."""
    rows = [r for r in rows if r["kind"] in ONE and r["strength"] >= least]
    named = [r["answer"].split("+")[0] or f"({r['verdict'].replace('_', ' ')})" for r in rows]
    truths = sorted({r["truth"] for r in rows})
    verdicts = {name for name in named if name.startswith("(")}
    names = sorted({*named, *truths} - verdicts) + sorted(verdicts)
    counts = np.zeros((len(truths), len(names)))
    for row, name in zip(rows, named, strict=True):
        counts[truths.index(row["truth"]), names.index(name)] += 1
    size = (2.6 + 0.26 * len(names), 2.2 + 0.24 * len(truths))
    figure, ax = plt.subplots(figsize=size, layout="constrained")
    ax.imshow(np.where(counts > 0, counts, np.nan), cmap="Blues", vmin=0, aspect="auto")
    for i, j in zip(*counts.nonzero(), strict=True):
        dark = counts[i, j] > 0.6 * counts.max()
        same = truths[i] == names[j]
        ax.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7, fontweight="bold" if same else None,
                color="white" if dark else "black" if same else WRONG)  # fmt: skip
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    ax.set_yticks(range(len(truths)), truths, fontsize=7)
    ax.set(xlabel="first name, or verdict", ylabel="truth")
    ax.set_title(f"Confusion, {least:.0f} nats and more", fontsize=10)
    ax.grid(alpha=0.2)
    save(figure, path, dpi)


def reliability(path: Path, bins: Sequence[Mapping[str, Any]], dpi: int) -> None:
    """How often a name is right against the probability stated for it."""
    figure, ax = plt.subplots(figsize=(4.2, 4.0), layout="constrained")
    ax.plot([0, 1], [0, 1], color=GREY, lw=1, ls="--")
    x, y = (np.array([b[k] for b in bins]) for k in ("stated", "right"))
    low, high = (np.array([b[k] for b in bins]) for k in ("low", "high"))
    if len(bins):
        ax.errorbar(x, y, np.maximum([y - low, high - y], 0), color=RIGHT, marker="o", ls="", capsize=4)
    for b in bins:
        ax.annotate(str(b["n"]), (b["stated"], b["right"]), xytext=(-14, 4), textcoords="offset points", fontsize=8)
    ax.set(xlabel="probability stated", ylabel="share right", xlim=(0, 1.02), ylim=(-0.03, 1.03),
           title="Reliability of the first name")  # fmt: skip
    ax.grid(alpha=0.25)
    save(figure, path, dpi)


def failure(
    path: Path, title: str, outputs: Sequence[str], white: Float[np.ndarray, "S T 12"],
    where: Float[np.ndarray, "S T"] | None, dpi: int,
) -> None:  # fmt: skip
    """What the best plain robot does not foretell: innovations squared in variances, smoothed, all sessions in a row.

    `where`: rows in which the concealed effect acts, if not in all.
    """
    sessions, rows, _ = white.shape
    smooth = np.apply_along_axis(lambda a: np.convolve(a, np.ones(_SMOOTH) / _SMOOTH, "same"), 1, white**2)
    figure, ax = plt.subplots(figsize=(9.0, 2.9), layout="constrained")
    # What a plain robot leaves of a real one is hundreds of variances.
    most = max(_MOST, float(np.quantile(smooth, 0.98)))
    image = ax.imshow(smooth.reshape(sessions * rows, -1).T, aspect="auto", cmap="magma_r",
                      norm=LogNorm(1.0, most, clip=True), interpolation="nearest")  # fmt: skip
    for s in range(1, sessions):
        ax.axvline(s * rows, color="white", lw=1.5)
    if where is not None:
        acts = np.flatnonzero(where.reshape(-1) > 0)
        ax.plot(acts, np.full(len(acts), -0.85), "|", color=RIGHT, ms=5, clip_on=False)
    ax.set_yticks(range(len(outputs)), outputs, fontsize=7)
    ax.set_xlabel("row (sessions side by side)")
    ax.set_title(title, fontsize=9, loc="left")
    figure.colorbar(image, ax=ax, label="variances", pad=0.01)
    save(figure, path, dpi)
