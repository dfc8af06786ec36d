"""The probability that the cause of what an effect explains is among its names, by experience.

Likelihoods compare names with each other. They say nothing of causes without a name, and take every law for exact. So
this probability comes from machines drawn at random (`simgap.ground`), with causes inside and outside the vocabulary: a
logistic regression on the indicators of the effects found on them. The stage `ground` fits it and keeps its table.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import expit

from simgap.diagnosis.validation.indicators import Indicators


class Term(NamedTuple):
    """Weight of an indicator, and the range beyond which experience says no more than at its end."""

    weight: float
    low: float
    high: float


INTERCEPT = 0.28
TERMS = {
    "gain": Term(0.24, 2.0, 9.0),
    "lesser": Term(-0.08, 0.0, 5.0),
    "misfit": Term(-0.23, 0.0, 7.0),
    "bending": Term(-0.94, 0.0, 1.0),
    "heldout": Term(0.42, -1.0, 2.0),
    "next_row": Term(-0.24, -3.0, 1.0),
    "far": Term(-0.78, -3.0, 1.0),
    "nameless": Term(-1.03, 0.0, 1.0),
    "rivals": Term(-0.07, 0.0, 3.0),
    "mistaken": Term(-0.99, -2.0, 2.5),
}
"""The logistic regression of reports/ground/calibration.json."""


def within(indicators: Indicators) -> Indicators:
    """The indicators, cut to their ranges."""
    return Indicators(**{name: float(np.clip(getattr(indicators, name), t.low, t.high)) for name, t in TERMS.items()})


def probability(indicators: Indicators) -> float:
    """That the cause is among the names in the credible set of an effect with these indicators."""
    return float(expit(INTERCEPT + sum(TERMS[name].weight * x for name, x in within(indicators)._asdict().items())))
