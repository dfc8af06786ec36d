"""Evidence for many directions, block by block, and the null distribution of its maximum.

With hundreds of hypotheses one fits well by chance. So the best is compared with the distribution of the best under
noise alone (block multiplier bootstrap).
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from simgap.diagnosis.config import BLOCK, FEW

DRAWS = 4000
AT_ONCE = 1000
"""Directions whose draws are kept in memory at once."""
NOTHING = 1e-4
"""Squared length of a direction [nats] that is nothing at all."""


class Evidence(NamedTuple):
    """What speaks for directions in every row that counts: score and information (twice its gain, were the effect there
    as it starts). two_sided: whether the direction can be gone along backwards."""

    score: Float[np.ndarray, "h n"]
    power: Float[np.ndarray, "h n"]
    two_sided: Bool[np.ndarray, " h"]


class Weighed(NamedTuple):
    """Evidence summed over rows. amplitude: of the start, by which the residual goes along with a direction. gain
    [nats]; statistic (chi-squared with one degree of freedom); left: what the score's blocks differ by, of length one.
    """

    amplitude: Float[np.ndarray, " h"]
    gain: Float[np.ndarray, " h"]
    statistic: Float[np.ndarray, " h"]
    left: Float[np.ndarray, "h B"]


def weigh(evidence: Evidence, starts: Int[np.ndarray, " B"]) -> Weighed:
    """How each direction and the residual go together; `starts` are those of the blocks."""
    score, power, two_sided = evidence
    in_blocks = partial(np.add.reduceat, indices=starts, axis=1, dtype=np.float64)
    if not len(starts):
        nil = np.zeros(len(score))
        return Weighed(nil, nil, nil, np.zeros((len(score), 0)))
    scores, powers = in_blocks(score), in_blocks(power)
    total, information = scores.sum(1), powers.sum(1)
    something = information > NOTHING
    amplitude = np.where(something, total / np.maximum(information, NOTHING), 0.0)
    # A law that acts in a few blocks only would be measured against itself, were its own part not taken out first.
    left = scores - amplitude[:, None] * powers
    variance, blocks_acted_in = _variance(score - amplitude[:, None] * power, left, powers, something)
    # Nor may such a law rest on a single block.
    along = scores * np.sign(total)[:, None]
    best = along.argmax(1)[:, None]
    first, its = (np.take_along_axis(a, best, 1)[:, 0] for a in (along, powers))
    rest, remaining = np.maximum(np.abs(total) - first, 0.0), 1 - its / np.maximum(information, NOTHING)
    single = blocks_acted_in < FEW
    total, variance = np.where(single, rest, np.abs(total)), np.where(single, variance * remaining, variance)
    possible = something & ((amplitude > 0) | two_sided)
    return Weighed(
        amplitude,
        np.where(possible, 0.5 * amplitude**2 * information, 0.0),
        np.where(possible, total**2 / np.maximum(variance, NOTHING), 0.0),
        left * (something / np.maximum(np.sqrt((left**2).sum(1)), NOTHING))[:, None],
    )


def _variance(
    rows: Float[np.ndarray, "h n"],
    left: Float[np.ndarray, "h B"],
    powers: Float[np.ndarray, "h B"],
    something: Bool[np.ndarray, " h"],
) -> tuple[Float[np.ndarray, " h"], Float[np.ndarray, " h"]]:
    """Of every direction's score, and the number of blocks that it acts in.

    Over rows, for the noise is not the same everywhere; times what rows of a block depend on each other, which a few
    blocks are too few to tell: theirs is drawn towards that of all directions. At least what the noise makes it.
    """
    information = np.maximum(powers.sum(1), NOTHING)
    acted_in = information**2 / np.maximum((powers**2).sum(1), NOTHING**2)
    over_rows = np.maximum((rows.astype(np.float64) ** 2).sum(1), NOTHING)
    dependence = (left**2).sum(1) / over_rows
    usual = np.median(dependence[something]) if something.any() else 1.0
    dependence = (FEW * usual + acted_in * dependence) / (FEW + acted_in)
    return np.maximum(over_rows * dependence, information), acted_in


def blocks(counts: np.ndarray) -> np.ndarray:
    """Starts of the blocks among the rows that count, none across two chunks."""
    starts, total = [], 0
    for n in counts.sum(1):
        starts += list(range(total, total + int(n), BLOCK))
        total += int(n)
    return np.array(starts, int)


def by_chance(weighed: Weighed, level: float, rng: np.random.Generator) -> tuple[float, float]:
    """Chance that noise alone gives as great a statistic as the greatest, and the one that it gives at `level`.

    Every block's score is noise then (multiplier bootstrap).
    """
    multipliers = rng.standard_normal((weighed.left.shape[1], DRAWS), np.float32)
    noise = np.zeros(DRAWS, np.float32)
    for first in range(0, len(weighed.left), AT_ONCE):
        some = weighed.left[first : first + AT_ONCE].astype(np.float32)
        noise = np.maximum(noise, ((some @ multipliers) ** 2).max(0))
    strongest = weighed.statistic.max(initial=0.0)
    return float((1 + (noise >= strongest).sum()) / (1 + len(noise))), float(np.quantile(noise, 1 - level))
