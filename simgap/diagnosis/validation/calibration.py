"""The probability that the cause of what an effect explains is among its names, by experience.

Likelihoods compare names with each other. They say nothing of causes without a name, and take every law for exact. So
this probability comes from machines drawn at random (`simgap.ground`), with causes inside and outside the vocabulary: a
logistic regression on the indicators of the effects found on them. The stage `ground` fits it and keeps its table.
"""

from math import prod

import numpy as np
from scipy.special import expit

from simgap.diagnosis.validation.indicators import Indicators

RANGES = {
    "gain": (2.0, 9.0),
    "lesser": (0.0, 5.0),
    "misfit": (0.0, 7.0),
    "bending": (0.0, 1.0),
    "heldout": (-1.0, 2.0),
    "next_row": (-3.0, 1.0),
    "far": (-3.0, 1.0),
    "nameless": (0.0, 1.0),
    "rivals": (0.0, 3.0),
    "mistaken": (-2.0, 2.5),
}
"""Of every indicator: beyond its ends, experience says no more than there."""
INTERCEPT = 0.24
WEIGHTS: dict[tuple[str, ...], float] = {
    ("gain",): 0.07,
    ("lesser",): -0.03,
    ("misfit",): -0.79,
    ("bending",): -0.73,
    ("heldout",): 0.8,
    ("next_row",): -0.29,
    ("far",): -1.37,
    ("nameless",): -0.14,
    ("rivals",): -0.09,
    ("mistaken",): -2.3,
    ("gain", "bending"): -1.12,
    ("lesser", "nameless"): 0.76,
    ("heldout", "heldout"): -0.57,
}
"""Of indicators, each from -1 to 1 over its range, and of products of them: the logistic regression of
reports/ground/calibration.json. A law that bends is less to be trusted the more clearly it shows; what is left without
a name matters less where a stronger effect was found; held-out rows should gain as much as fitted ones, not more."""


def features(indicators: Indicators) -> list[float]:
    """What each of the weights multiplies."""
    at = {name: _scaled(getattr(indicators, name), *ends) for name, ends in RANGES.items()}
    return [prod(at[name] for name in names) for names in WEIGHTS]


def probability(indicators: Indicators) -> float:
    """That the cause is among the names in the credible set of an effect with these indicators."""
    return float(expit(INTERCEPT + sum(w * x for w, x in zip(WEIGHTS.values(), features(indicators), strict=True))))


def _scaled(value: float, low: float, high: float) -> float:
    """From -1 to 1 over a range, and no further."""
    return float(np.clip(2 * (value - low) / (high - low) - 1, -1, 1))
