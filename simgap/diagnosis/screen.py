"""Which of many hypotheses deserve a fit, and whether the best of them is more than the best of noise.

Every hypothesis is a direction in the innovations: the change d that its effect makes at a starting value. What phi,
gain and the constants at hand can absorb of d is projected out; the rest says how much an effect of this kind could
gain, and a bootstrap of the current model's scores says how much the best of all directions gains by chance.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.candidates import Candidate
from simgap.diagnosis.fit import Fit, Problem, replaced, side_by_side, trials, weights
from simgap.diagnosis.innovations import Variables

BLOCK = 20
"""Rows whose scores are taken to be dependent."""
PART = 8
"""Directions that are kept in memory at once, and the most promising ones, which are tested where they lead to."""
DRAWS = 4000
NOTHING = 1e-4
"""Squared length of a direction [nats] that is nothing at all."""


class Screened(NamedTuple):
    """A hypothesis at a start: gain expected [nats], and its test statistic (chi-squared with one degree of freedom).

    constant: the one tested. power: nats that an effect at the starting value would gain, so what the recordings could
    have shown.
    """

    candidate: Candidate
    start: tuple[float, ...]
    constant: int
    gain: float
    statistic: float
    power: float


class _Direction(NamedTuple):
    """One constant of a hypothesis at its start, the other amplitudes zero."""

    candidate: Candidate
    values: tuple[float, ...]
    constant: int


class Screening(NamedTuple):
    """All hypotheses, best first, and the chance that noise alone gives as good a best one."""

    found: list[Screened]
    p_value: float
    threshold: float  # of the statistic, at `level`


def vary(v: Variables, candidate: Candidate, constants: Sequence[float]) -> Variables:
    """v with the candidate's constants set."""
    theta, gated = v.theta, v.gated
    for group, value in zip(candidate.groups, constants, strict=True):
        if group.gated:
            gated = replaced(gated, group.entries, value)
        else:
            theta = replaced(theta, group.entries, value)
    return v._replace(theta=theta, gated=gated)


def _directions(candidates: Sequence[Candidate]) -> list[_Direction]:
    """Every constant of every hypothesis at all of its starts, shapes at their start as well."""
    found = []
    for candidate in candidates:
        shapes = [c.shapes for c in candidate.effect.constants]
        for start in candidate.starts:
            for k, shape in enumerate(shapes):
                if not shape:
                    values = tuple(v if j == k or shapes[j] else 0.0 for j, v in enumerate(start))
                    found.append(_Direction(candidate, values, k))
    return found


def screen(
    problem: Problem,
    fit: Fit,
    absorbing: Float[np.ndarray, "M n s"],
    candidates: Sequence[Candidate],
    level: float,
    rng: np.random.Generator,
) -> Screening:
    """Test all hypotheses against the fitted model; `absorbing` are the derivatives of all that is free in it."""
    w = weights(fit.e, fit.noise).astype(np.float32)
    root = np.sqrt(w).reshape(-1)
    basis, _ = np.linalg.qr((absorbing.reshape(len(absorbing), -1) * root).T)
    # At the optimum the residual has no part in what the model can absorb; float32 leaves a trace.
    residual = fit.e.reshape(-1) * root
    residual = residual - basis @ (basis.T @ residual)
    cuts = (blocks(np.asarray(problem.chunks.counts)), len(fit.e))
    directions = _directions(candidates)
    low, _ = problem.augmented.bounds

    def batch(some: Sequence[_Direction]) -> list[tuple[Screened, np.ndarray]]:
        vs = [vary(fit.v, candidate, values) for candidate, values, _ in some]
        with np.errstate(over="ignore", invalid="ignore"):  # a start may explode; it is then left out
            change = trials(problem, vs) - fit.e
            d = change.reshape(len(some), -1) * root
            d = _beyond_twin(problem, fit, some, d, root)
            d = d - (d @ basis) @ basis.T
            tested = [_test(*s, along, residual, cuts, low) for s, along in zip(some, d, strict=True)]
        return [t for t in tested if t is not None]

    parts = [directions[first : first + PART] for first in range(0, len(directions), PART)]
    results = [t for part in side_by_side(batch, parts) for t in part]
    # A strong effect is another direction where it stands than near nil: the most promising are tested there as well.
    best = sorted((s for s, _ in results), key=lambda s: -s.gain)[:PART]
    results += batch([_Direction(s.candidate, s.start, s.constant) for s in best])
    found, scores = [s for s, _ in results], [score for _, score in results]
    noise = _best_of_noise(np.array(scores), rng)
    strongest = max((s.statistic for s in found), default=0.0)
    p_value = float((1 + (noise >= strongest).sum()) / (1 + len(noise)))
    found.sort(key=lambda s: -s.gain)
    return Screening(found, p_value, float(np.quantile(noise, 1 - level)))


def _beyond_twin(
    problem: Problem,
    fit: Fit,
    some: Sequence[_Direction],
    d: np.ndarray,
    root: np.ndarray,
) -> Float[np.ndarray, "k m"]:
    """Directions less their part along the same effect acting everywhere, for hypotheses that have such a twin."""
    have = [i for i, (candidate, _, _) in enumerate(some) if candidate.twin]
    if not have:
        return d
    twins = [vary(fit.v, c._replace(groups=c.twin), values) for c, values, _ in (some[i] for i in have)]
    t = np.zeros_like(d)
    t[have] = (trials(problem, twins) - fit.e).reshape(len(have), -1) * root
    power = (t * t).sum(1, keepdims=True)
    return d - t * (d * t).sum(1, keepdims=True) / np.maximum(power, NOTHING)


def _test(
    candidate: Candidate,
    values: tuple[float, ...],
    k: int,
    direction: Float[np.ndarray, " m"],
    residual: Float[np.ndarray, " m"],
    cuts: tuple[np.ndarray, int],
    low: Float[np.ndarray, " P"],
) -> tuple[Screened, Float[np.ndarray, " B"]] | None:
    """One hypothesis: how its direction and the residual go together, block by block; None where it diverges."""
    power = float(direction @ direction)
    if not np.isfinite(power):
        return None
    in_blocks = lambda a: np.add.reduceat(a.reshape(cuts[1], -1).sum(1), cuts[0])  # noqa: E731
    score, powers = -in_blocks(direction * residual), in_blocks(direction * direction)
    total = float(score.sum())
    if power < NOTHING:
        return Screened(candidate, values, k, 0.0, 0.0, 0.0), np.zeros_like(score)
    amplitude = total / power
    # A law that acts in a few blocks only would be measured against itself, were its own part not taken out first; and
    # what is left of those few is too little to tell their variance, which is at least what the noise makes it.
    left = score - amplitude * powers
    variance = max(float(left @ left), power)
    two_sided = low[candidate.groups[k].entries[0]] < 0
    possible = amplitude > 0 or two_sided
    # A law that is linear in its constant can start where the data would have it.
    start = tuple(v * float(np.clip(amplitude, -3, 3)) if j == k and two_sided else v for j, v in enumerate(values))
    gain, statistic = (0.5 * total**2 / power, total**2 / variance) if possible else (0.0, 0.0)
    return Screened(candidate, start, k, gain, statistic, 0.5 * power), left / max(np.sqrt(float(left @ left)), NOTHING)


def blocks(counts: np.ndarray) -> np.ndarray:
    """Starts of the blocks among the rows that count, none across two chunks."""
    starts, total = [], 0
    for n in counts.sum(1):
        starts += list(range(total, total + int(n), BLOCK))
        total += int(n)
    return np.array(starts)


def _best_of_noise(scores: Float[np.ndarray, "h B"], rng: np.random.Generator) -> Float[np.ndarray, " draws"]:
    """Greatest statistic over all hypotheses when every block's score is noise (multiplier bootstrap)."""
    multipliers = rng.standard_normal((scores.shape[1], DRAWS), np.float32)
    return ((scores.astype(np.float32) @ multipliers) ** 2).max(0)
