"""Result for an effect that changes the noise and not the mean."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.likelihood.student_t import Noise
from simgap.types import Field

OTHER = "other_noise"
"""Stands in place of an effect's id: unnamed noise, which includes outliers and misfit of the laws of the mean."""


class Axis(NamedTuple):
    """The x axis along a direction: its label, x of the plain rows, x per length of the direction, and edges of the
    bins in such lengths from the plain rows."""

    label: str
    plain: float
    unit: float
    edges: Float[np.ndarray, " b"]


class Between(NamedTuple):
    """Rows as a mixture: innovations under each hypothesis, the plain one first; the shares of the hypotheses; and a
    direction along which the innovations differ."""

    several: Sequence[Float[np.ndarray, "n s"]]
    direction: Float[np.ndarray, "n s"]
    shares: Float[np.ndarray, " k"]
    noise: Noise
    axis: Axis


class Widening(NamedTuple):
    """Innovations whose scale grows from 1 at rest to `ratio` at the usual speed."""

    e: Float[np.ndarray, "n c"]
    noise: Noise
    moving: Float[np.ndarray, "n c"]
    ratio: float


class Spectrum(NamedTuple):
    """Power spectrum of an output's innovations, summed over segments: a peak at bin k, and the level around it.

    hertz: width of a bin.
    """

    power: Float[np.ndarray, " f"]
    level: float
    k: int
    segments: int
    hertz: float
    field: Field


class NoiseEffect(NamedTuple):
    """An effect on the noise: constants [{name, value, unit, ci95}], gains in training and held-out rows [nats].

    Gains are over the most likely unnamed noise. rare: it concerns single rows. odds: probability of every id that
    could stand in its place, including `OTHER`. shown: the law and the data, as `noise_figures` draws them.
    """

    id: str
    rare: bool
    constants: list[dict[str, Any]]
    outputs: tuple[str, ...]
    statement: str
    gain: float
    heldout_gain: float
    odds: dict[str, float]
    shown: Between | Widening | Spectrum

    @property
    def predictable(self) -> bool:
        """Whether innovations with it can be predicted in part: an oscillation, or outlier rows."""
        return self.rare or isinstance(self.shown, Spectrum)
