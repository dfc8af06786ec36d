"""Bootstrap intervals of means: units of pieces are drawn with replacement [Efron 1979]."""

from typing import Any

import numpy as np
from jaxtyping import Float

DRAWS = 1000
Draws = Float[np.ndarray, "draws n"]
"""How often each piece is drawn: once in the first row, which is the sample itself, then in bootstrap draws."""


def resample(unit: np.ndarray, rng: np.random.Generator) -> Draws:
    """Draw units with replacement; `unit` is the number of each piece's unit. All pieces come first, then the draws."""
    unit = np.unique(unit, return_inverse=True)[1]
    number = int(unit.max()) + 1
    drawn = [np.bincount(rng.integers(0, number, number), minlength=number)[unit] for _ in range(DRAWS)]
    return np.array([np.ones(len(unit)), *drawn])


def averages(values: Float[np.ndarray, "n k"], draws: Draws) -> Float[np.ndarray, "draws k"]:
    """Column means over the pieces drawn; infinite where one of these is not finite."""
    finite = np.isfinite(values)
    means = draws @ np.where(finite, values, 0.0).astype(float) / draws.sum(1, keepdims=True)
    return np.where(draws @ ~finite > 0, np.inf, means)


def averages_known(values: Float[np.ndarray, " n"], draws: Draws) -> Float[np.ndarray, " draws"]:
    """Means over the pieces drawn, without those that are nan."""
    known = ~np.isnan(values)
    with np.errstate(invalid="ignore"):  # all are nan
        return draws[:, known] @ values[known] / draws[:, known].sum(1)


def interval(values: Float[np.ndarray, " draws"]) -> dict[str, Any]:
    """Value over all pieces, and the 95 % interval of the draws."""
    # Quantiles are draws: some may be infinite, so interpolation between them has no meaning.
    low, high = np.nanquantile(values[1:], [0.025, 0.975], method="nearest")
    return {"value": float(values[0]), "ci95": [float(low), float(high)]}
