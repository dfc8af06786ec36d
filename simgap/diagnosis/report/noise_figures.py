"""Numbers behind the figures of effects on the noise: each law with the data that it explains."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from simgap.diagnosis.inference.noise.effect import Axis, Between, Spectrum, Widening
from simgap.diagnosis.likelihood.student_t import Noise
from simgap.diagnosis.report.figures import binned
from simgap.types import Field

CERTAIN = 0.35
"""A row is shown if its position between two hypotheses has at most this standard deviation."""
FEWEST = 30
"""Minimum rows of a figure."""
ERROR_OF_MAD = 1.17
"""Standard error of the median absolute deviation, times the root of the number of values, relative to the scale."""


def picture(shown: Between | Widening | Spectrum) -> list[dict[str, Any]]:
    """The figure of a law with the data that it explains; none if too few rows are informative."""
    match shown:
        case Between():
            return _between(*shown)
        case Widening():
            return _widening(*shown)
        case Spectrum():
            return _spectrum(*shown)


def _between(
    several: Sequence[Float[np.ndarray, "n s"]],
    direction: Float[np.ndarray, "n s"],
    shares: Float[np.ndarray, " k"],
    noise: Noise,
    axis: Axis,
) -> list[dict[str, Any]]:
    """Histogram of the innovations' positions along a direction, with the mixture of hypotheses.

    Rows that hardly move along the direction are uninformative and left out. No figure if too few remain.
    """
    weights = direction / noise.scale**2
    length = (direction * weights).sum(1)
    keep = length > CERTAIN**-2
    if keep.sum() < FEWEST:
        return []
    at, *under = (((several[0] - e) * weights).sum(1)[keep] / length[keep] for e in (0 * direction, *several))
    sd = 1 / np.sqrt(length[keep])[:, None]
    edges, (rows, _) = axis.edges, np.histogram(at, axis.edges)
    expected = np.asarray(shares) @ np.stack([np.diff(ndtr((edges - a[:, None]) / sd)).sum(0) for a in under])
    x, seen, likely = axis.plain + axis.unit * (edges[1:] + edges[:-1]) / 2, rows > 0, expected > 0.5
    return [{
        "title": "Effect on single rows", "x_label": axis.label, "y_label": "rows", "y_scale": "log",
        "x": x[seen], "y": rows[seen], "y_err": np.minimum(1.96 * np.sqrt(rows), 0.9 * rows)[seen],
        "line_x": x[likely], "line_y": expected[likely],
        "caption": "Dots: rows that can distinguish the laws (95 % interval). Line: number that the law predicts.",
    }]  # fmt: skip


def _widening(
    e: Float[np.ndarray, "n c"], noise: Noise, moving: Float[np.ndarray, "n c"], ratio: float
) -> list[dict[str, Any]]:
    """Noise over speed, relative to the noise at rest, and the law's line from 1 to `ratio`."""
    standard, moving = np.abs(e / noise.scale).ravel(), moving.ravel()
    at_rest = np.median(standard / (1 + (ratio - 1) * moving))
    members = binned(moving)
    if len(members) < 3:
        return []
    x = [float(moving[m].mean()) for m in members]
    y = [float(np.median(standard[m]) / at_rest) for m in members]
    return [{
        "title": "Effect on the noise", "x_label": "motion, 1 at the usual speed [-]",
        "y_label": "noise, 1 at rest [-]",
        "x": x, "y": y,
        "y_err": [1.96 * ERROR_OF_MAD * w / np.sqrt(standard[m].size) for w, m in zip(y, members, strict=True)],
        "line_x": x, "line_y": [1 + (ratio - 1) * m for m in x],
        "caption": "Dots: median size of the innovations (95 % interval). Line: the law.",
    }]  # fmt: skip


def _spectrum(
    power: Float[np.ndarray, " f"], level: float, k: int, segments: int, hertz: float, field: Field
) -> list[dict[str, Any]]:
    """Spectrum of an output's innovations: a peak, and the level around it."""
    peak = (power[k - 1 : k + 2] - level).clip(0).sum()
    line = np.full(len(power), level)
    line[k - 1 : k + 2] += peak * np.array([1, 4, 1]) / 6  # as Hann's window spreads it
    shown = np.arange(1, len(power))
    x, y = hertz * shown, power[shown] / segments
    return [{
        "title": f"Spectrum of the residuals of {field.name}", "x_label": "frequency [Hz]",
        "y_label": f"power [({field.unit})²]", "y_scale": "log",
        "x": x, "y": y, "y_err": min(1.96 / np.sqrt(segments), 0.9) * y,
        "line_x": x, "line_y": line[shown] / segments,
        "caption": "Dots: measured (95 % interval). Line: the peak, and the level around it.",
    }]  # fmt: skip
