"""Evidence for many directions, block by block, and the null distribution of its maximum.

With hundreds of hypotheses one fits well by chance. So the best is compared with the null distribution of the maximum
(block multiplier bootstrap).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from simgap.diagnosis.config import BLOCK, FEW, LEAST_BLOCK

DRAWS = 4000
AT_ONCE = 1000
"""Directions whose draws or squares are kept in memory at once."""
LOOKS = 8
"""Looks that are weighed at once: they read the evidence once."""
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
    scores, powers = (np.add.reduceat(a, starts, axis=1, dtype=np.float64) for a in (score, power))
    (squares,) = _squares(evidence, np.ones((1, score.shape[1]), bool))
    return _weighed(_Sums(scores, powers, squares), two_sided)


def weigh_each(evidence: Evidence, starts: Int[np.ndarray, " B"], looks: Bool[np.ndarray, "L n"]) -> Iterator[Weighed]:
    """The same over the rows of each look, one look at a time."""
    scores, powers = (_in_blocks(a, starts) for a in evidence[:2])
    squares = _squares(evidence, looks)
    for first in range(0, len(looks), LOOKS):
        rows = _in_blocks(looks[first : first + LOOKS].astype(np.float32), starts).swapaxes(1, 2)
        for k, sums in enumerate(zip((rows @ scores).swapaxes(0, 1), (rows @ powers).swapaxes(0, 1), strict=True)):
            in_blocks = (a.T.astype(np.float64) for a in sums)
            yield _weighed(_Sums(*in_blocks, squares=squares[first + k]), evidence.two_sided)


def _in_blocks(a: Float[np.ndarray, "h n"], starts: Int[np.ndarray, " B"]) -> Float[np.ndarray, "B k h"]:
    """The columns of each block, which zeros pad to the longest one."""
    lengths = np.diff(starts, append=a.shape[1])
    place = np.arange(lengths.max(initial=0))
    columns = np.where(place < lengths[:, None], starts[:, None] + place, a.shape[1])
    return np.concatenate([a.T, np.zeros_like(a[:, :1]).T])[columns]


def _squares(evidence: Evidence, looks: Bool[np.ndarray, "L n"]) -> Float[np.ndarray, "L 3 h"]:
    """Sums over the rows of each look of squared scores, of scores times powers, and of squared powers."""
    sums, rows = np.zeros((len(looks), 3, len(evidence.score))), looks.T.astype(np.float64)
    for first in range(0, len(evidence.score), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        score, power = evidence.score[part].astype(np.float64), evidence.power[part].astype(np.float64)
        for k, product in enumerate((score * score, score * power, power * power)):
            sums[:, k, part] = (product @ rows).T
    return sums


class _Sums(NamedTuple):
    """Score and information of every block, and `_squares` over all rows."""

    scores: Float[np.ndarray, "h B"]
    powers: Float[np.ndarray, "h B"]
    squares: Float[np.ndarray, "3 h"]


def _weighed(sums: _Sums, two_sided: Bool[np.ndarray, " h"]) -> Weighed:
    scores, powers, _ = sums
    if not scores.shape[1]:
        zero = np.zeros(len(scores))
        return Weighed(zero, zero, zero, scores)
    total, information = scores.sum(1), powers.sum(1)
    informative = information > NOTHING
    amplitude = np.where(informative, total / np.maximum(information, NOTHING), 0.0)
    # Subtract the fitted effect: a law that acts in a few blocks would otherwise inflate its own variance.
    left = scores - amplitude[:, None] * powers
    over_rows = sums.squares[0] - 2 * amplitude * sums.squares[1] + amplitude**2 * sums.squares[2]
    variance, blocks_acted_in = _variance(over_rows, left, powers, informative)
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
    over_rows: Float[np.ndarray, " h"],
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
    over_rows = np.maximum(over_rows, NOTHING)
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
