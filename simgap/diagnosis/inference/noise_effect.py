"""What is said of an effect that moves the scatter and not the mean."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.likelihood.student_t import Noise
from simgap.types import Field

REQUIRED = 10.0
"""Least gain [nats]; hypotheses on the scatter have two or three constants each."""
OTHER = "other_noise"
"""In place of an effect's id: noise that has no name, outliers among it, and misfit of the laws of the mean."""


class Axis(NamedTuple):
    """Along a direction: what x is called, where the plain rows lie on it, what the direction's length is there; and
    edges of the bins, in such lengths from the plain rows."""

    label: str
    plain: float
    unit: float
    edges: Float[np.ndarray, " b"]


class Between(NamedTuple):
    """What a mixture says of rows: innovations under each hypothesis, the plain one first, of the given shares, and a
    direction along which they differ."""

    several: Sequence[Float[np.ndarray, "n s"]]
    direction: Float[np.ndarray, "n s"]
    shares: Float[np.ndarray, " k"]
    noise: Noise
    axis: Axis


class Widening(NamedTuple):
    """Innovations whose scale grows from 1 at rest to the ratio at the usual speed."""

    e: Float[np.ndarray, "n c"]
    noise: Noise
    moving: Float[np.ndarray, " n"]
    ratio: float


class Spectrum(NamedTuple):
    """Power of an output's innovations by frequency, summed over segments, a wave at bin k, the level around it.

    hertz: width of a bin.
    """

    power: Float[np.ndarray, " f"]
    level: float
    k: int
    segments: int
    hertz: float
    field: Field


class NoiseEffect(NamedTuple):
    """An effect on the scatter: constants [{name, value, unit, ci95}], gains in training and held-out rows [nats].

    Gains are over the likeliest noise that has no name. rare: it is a matter of single rows. odds: probability of every
    id that could stand in its place, `OTHER` among them. shown: the law and the data, as `scatter_pictures` draws them.
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
