"""Evidence for many directions, block by block, and the null distribution of its maximum.

With hundreds of hypotheses one fits well by chance. So the best is compared with the null distribution of the maximum
(block multiplier bootstrap).
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from simgap.diagnosis.config import BLOCK, FEW, LEAST_BLOCK

DRAWS = 4000
AT_ONCE = 1000
"""Directions whose draws are kept in memory at once."""
NOTHING = 1e-4
"""Information [nats] below this counts as zero."""


class Evidence(NamedTuple):
    """Score and information of directions in every row that counts. two_sided: whether the amplitude may be negative.

    The information is twice the gain of an effect that has its starting value.
    """

    score: Float[np.ndarray, "h n"]
    power: Float[np.ndarray, "h n"]
    two_sided: Bool[np.ndarray, " h"]


class Weighed(NamedTuple):
    """Evidence summed over rows. amplitude: the best along a direction, in units of its start. gain [nats].

    statistic: chi-squared with one degree of freedom. left: residuals of the blocks' scores, scaled to length one.
    """

    amplitude: Float[np.ndarray, " h"]
    gain: Float[np.ndarray, " h"]
    statistic: Float[np.ndarray, " h"]
    left: Float[np.ndarray, "h B"]


def weigh(evidence: Evidence, starts: Int[np.ndarray, " B"]) -> Weighed:
    """Amplitude, gain and test statistic of each direction. starts: first rows of the blocks."""
    score, power, two_sided = evidence
    in_blocks = partial(np.add.reduceat, indices=starts, axis=1, dtype=np.float64)
    if not len(starts):
        zero = np.zeros(len(score))
        return Weighed(zero, zero, zero, np.zeros((len(score), 0)))
    scores, powers = in_blocks(score), in_blocks(power)
    total, information = scores.sum(1), powers.sum(1)
    informative = information > NOTHING
    amplitude = np.where(informative, total / np.maximum(information, NOTHING), 0.0)
    # Subtract the fitted effect: a law that acts in a few blocks would otherwise inflate its own variance.
    left = scores - amplitude[:, None] * powers
    variance, blocks_acted_in = _variance(score - amplitude[:, None] * power, left, powers, informative)
    # Such a law must not rest on a single block: its strongest is left out.
    signed = scores * np.sign(total)[:, None]
    best = signed.argmax(1)[:, None]
    first, power_of_best = (np.take_along_axis(a, best, 1)[:, 0] for a in (signed, powers))
    rest, remaining = np.maximum(np.abs(total) - first, 0.0), 1 - power_of_best / np.maximum(information, NOTHING)
    single = blocks_acted_in < FEW
    total, variance = np.where(single, rest, np.abs(total)), np.where(single, variance * remaining, variance)
    possible = informative & ((amplitude > 0) | two_sided)
    return Weighed(
        amplitude,
        np.where(possible, 0.5 * amplitude**2 * information, 0.0),
        np.where(possible, total**2 / np.maximum(variance, NOTHING), 0.0),
        left * (informative / np.maximum(np.sqrt((left**2).sum(1)), NOTHING))[:, None],
    )


def _variance(
    rows: Float[np.ndarray, "h n"],
    left: Float[np.ndarray, "h B"],
    powers: Float[np.ndarray, "h B"],
    informative: Bool[np.ndarray, " h"],
) -> tuple[Float[np.ndarray, " h"], Float[np.ndarray, " h"]]:
    """Variance of every direction's score, and the number of blocks that it acts in.

    The variance is that over rows, because the noise is not the same everywhere, times a factor for dependence within
    blocks. A few blocks do not determine the factor: theirs is shrunk towards the median of all directions. The
    variance is at least the information, its value under independent noise.
    """
    information = np.maximum(powers.sum(1), NOTHING)
    acted_in = information**2 / np.maximum((powers**2).sum(1), NOTHING**2)
    over_rows = np.maximum((rows.astype(np.float64) ** 2).sum(1), NOTHING)
    dependence = (left**2).sum(1) / over_rows
    usual = np.median(dependence[informative]) if informative.any() else 1.0
    dependence = (FEW * usual + acted_in * dependence) / (FEW + acted_in)
    return np.maximum(over_rows * dependence, information), acted_in


def short(counts: np.ndarray) -> bool:
    """Whether there are too few rows for `FEW` blocks of the usual length."""
    return bool(counts.sum() < FEW * BLOCK)


def blocks(counts: np.ndarray) -> np.ndarray:
    """First rows of the blocks, among the rows that count. No block crosses two segments.

    Short recordings have shorter blocks, so that there are `FEW` of them.
    """
    starts, total = [], 0
    length = max(int(counts.sum()) // FEW, LEAST_BLOCK) if short(counts) else BLOCK
    for n in counts.sum(1):
        starts += list(range(total, total + int(n), length))
        total += int(n)
    return np.array(starts, int)


class Chance(NamedTuple):
    """The null distribution of the greatest statistic. maxima: draws of it. enough: whether there are enough blocks."""

    maxima: Float[np.ndarray, " draws"]
    enough: bool

    def p_value(self, statistic: float) -> float:
        """Probability of a statistic as great under noise alone; one if there are too few blocks to say."""
        return float((1 + (self.maxima >= statistic).sum()) / (1 + len(self.maxima))) if self.enough else 1.0

    def critical(self, level: float) -> float:
        """The statistic that noise alone exceeds with that probability."""
        return float(np.quantile(self.maxima, 1 - level))


def by_chance(weighed: Weighed, rng: np.random.Generator) -> Chance:
    """What noise alone gives: random weights on the blocks' scores (multiplier bootstrap)."""
    multipliers = rng.standard_normal((weighed.left.shape[1], DRAWS), np.float32)
    noise = np.zeros(DRAWS, np.float32)
    for first in range(0, len(weighed.left), AT_ONCE):
        part = weighed.left[first : first + AT_ONCE].astype(np.float32)
        noise = np.maximum(noise, ((part @ multipliers) ** 2).max(0))
    return Chance(noise, weighed.left.shape[1] >= FEW)
