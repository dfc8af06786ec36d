"""Result of a score test: what every hypothesis would gain, and what noise alone would."""

from typing import NamedTuple

import numpy as np

from simgap.diagnosis.config import LEVEL
from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.inference.evidence.null_distribution import NOTHING, Chance, Evidence


class Screened(NamedTuple):
    """A hypothesis at a start: expected gain [nats] and test statistic (chi-squared with one degree of freedom).

    constant: index of the one tested; tested: its value in the test. power: gain [nats] of an effect of that value, so
    what the recordings could have shown. unmoved: the same if nothing that is fitted moved to take its place.
    """

    hypothesis: Hypothesis
    start: tuple[float, ...]
    constant: int
    gain: float
    statistic: float
    power: float
    unmoved: float
    tested: float

    @property
    def as_it_stands(self) -> float:
        """Expected gain [nats] at the start itself, rather than with the best amplitude along its direction."""
        return 2 * np.sqrt(self.gain * self.power) - self.power


class Screening(NamedTuple):
    """All hypotheses, best first, the evidence for each, and what noise alone gives.

    untested: names of the hypotheses with which the simulator diverges from every start.
    """

    found: list[Screened]
    evidence: Evidence
    chance: Chance
    untested: tuple[str, ...]

    @property
    def p_value(self) -> float:
        """Of the greatest statistic."""
        return self.chance.p_value(max((s.statistic for s in self.found), default=0.0))

    @property
    def threshold(self) -> float:
        """Critical value of the statistic at `LEVEL`."""
        return self.chance.critical(LEVEL)

    def p_value_of_fit(self, name: str, gain: float) -> float:
        """Of a fitted hypothesis and its gain [nats]: the likelihood ratio, scaled as the variance of its score is.

        A fit moves the filter gain and the parameters along, so it can gain far more than its derivative promises.
        """
        s = next(s for s in self.found if s.hypothesis.name == name)
        return self.chance.p_value(gain * min(s.statistic / max(s.gain, NOTHING), 2.0))
