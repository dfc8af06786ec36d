"""The one door to matplotlib: figures as files."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image

from simgap.formats.documents import write_bytes

LABELS = {
    "sim_model": "SIM-MODEL",
    "sim_model_diagnosed": "SIM-MODEL + diagnosed",
    "fsvgd": "FSVGD",
    "sim_fsvgd": "Sim-FSVGD",
    "sim_fsvgd_diagnosed": "Sim-FSVGD + diagnosed",
    "residual_diagnosed": "Diagnosed + residual",
}
NOISES = {"gaussian": "Gaussian noise (the paper's)", "student_t": "Student's t noise"}
# Colour, marker, line; a model that is given a diagnosis in the hue of its twin, dashed, its markers hollow.
STYLE = {
    "sim_model": ("#7f7f7f", "s", "-"),
    "sim_model_diagnosed": ("#4a4a4a", "s", "--"),
    "fsvgd": ("#d1722d", "^", "-"),
    "sim_fsvgd": ("#1f5fa8", "o", "-"),
    "sim_fsvgd_diagnosed": ("#3f95e0", "o", "--"),
    "residual_diagnosed": ("#2a8a4a", "D", "--"),
}
_LINES = (("#2a8a4a", "-"), ("#2a8a4a", "--"), ("#7f7f7f", "-"), ("#d1722d", "-"))
_JITTER = 0.012  # of the N range, so that models' points do not hide each other


def against_n(
    path: Path, rows: Sequence[dict[str, Any]], panels: Sequence[tuple[str, str, str]], title: str, dpi: int
) -> None:
    """A panel per (noise, score, label): mean over seeds with its spread (one std), every seed a dot, against N.

    `rows` are scores, one a cell.
    """
    figure, axes = plt.subplots(1, len(panels), figsize=(4.6 * len(panels), 3.8), squeeze=False, layout="constrained")
    for ax, (noise, score, label) in zip(axes[0], panels, strict=True):
        seeds_and_spread(ax, [r for r in rows if r["noise"] == noise], score)
        ax.set(xlabel="transitions N", ylabel=label, title=NOISES[noise])
    figure.legend(
        *axes[0][0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=1 + len(panels),
        frameon=False,
        fontsize="small",
    )
    figure.suptitle(title, fontweight="bold")
    save(figure, path, dpi)


def against_rows(
    path: Path,
    rows: Sequence[int],
    curves: Mapping[str, Mapping[str, Sequence[float]]],
    bodies: Mapping[str, str],
    dpi: int,
) -> None:
    """A panel per body: mean distance [m] from what was measured against the rows predicted, a line per curve."""
    figure, axes = plt.subplots(1, len(bodies), figsize=(4.6 * len(bodies), 3.8), sharey=True, layout="constrained")
    for ax, (body, name) in zip(axes, bodies.items(), strict=True):
        for (label, curve), (colour, line) in zip(curves.items(), _LINES, strict=True):
            ax.plot(rows, curve[body], line, color=colour, marker=".", label=label)
        ax.set(xlabel="rows predicted", title=name)
        ax.grid(alpha=0.25)
    axes[0].set_ylabel("mean distance from measured [m]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    figure.suptitle("Sessions that were held out", fontweight="bold")
    save(figure, path, dpi)


def stated_and_observed(path: Path, bins: Sequence[Mapping[str, Any]], dpi: int) -> None:
    """Stated against observed shares, with their standard errors. A bin: `stated`, `right`, number of `effects`."""
    figure, ax = plt.subplots(figsize=(4.6, 4.2), layout="constrained")
    stated, right, n = (np.array([b[key] for b in bins]) for key in ("stated", "right", "effects"))
    ax.plot([0, 1], [0, 1], color="0.7", label="as stated")
    ax.errorbar(stated, right, np.sqrt(stated * (1 - stated) / n), fmt="o", color="#1f5fa8", label="effects found")
    for x, y, count in zip(stated, right, n, strict=True):
        ax.annotate(str(count), (x, y), textcoords="offset points", xytext=(7, -11), color="0.4", fontsize="small")
    ax.set(xlabel="stated: the cause is among the names", ylabel="share of effects where it is", xlim=(0, 1),
           ylim=(0, 1.02), title="Families of causes that were held out")  # fmt: skip
    ax.legend(loc="upper left", frameon=False)
    save(figure, path, dpi)


def save(figure: Figure, path: Path, dpi: int) -> None:
    """Write a figure as PNG with a palette of 64 colours, a quarter of the size, as git keeps it; and close it."""
    whole = io.BytesIO()
    figure.savefig(whole, dpi=dpi)
    plt.close(figure)
    small = io.BytesIO()
    palette = Image.open(whole).convert("RGB").quantize(64, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    palette.save(small, "PNG", optimize=True)
    write_bytes(path, small.getvalue())


def seeds_and_spread(ax: Axes, rows: Sequence[dict[str, Any]], score: str) -> None:
    """Mean over seeds with its spread (one std) by model and N, and every seed as a dot."""
    sizes = sorted({r["sample_size"] for r in rows})
    shift = _JITTER * (max(sizes) - min(sizes) or 1)
    models = [model for model in LABELS if any(r["model"] == model for r in rows)]
    for k, model in enumerate(models):
        colour, marker, line = STYLE[model]
        groups = [(n, [r[score] for r in rows if r["model"] == model and r["sample_size"] == n]) for n in sizes]
        groups = [(n, values) for n, values in groups if values]
        x = [n + (k - (len(models) - 1) / 2) * shift for n, _ in groups]
        means = [float(np.mean(v)) for _, v in groups]
        spread = [float(np.std(v, ddof=1)) if len(v) > 1 else 0.0 for _, v in groups]
        face = "white" if line == "--" else colour
        ax.errorbar(x, means, spread, color=colour, marker=marker, ls=line, mfc=face, capsize=3, lw=1.6, ms=6,
                    label=LABELS[model])  # fmt: skip
        for position, (_, values) in zip(x, groups, strict=True):
            ax.plot([position] * len(values), values, ".", color=colour, alpha=0.45, ms=5)
    ax.set_xticks(sizes)
    ax.yaxis.set_major_locator(MaxNLocator(6))
    ax.grid(alpha=0.25)
