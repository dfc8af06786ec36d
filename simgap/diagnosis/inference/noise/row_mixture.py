"""Mixtures for single rows of innovations: each row follows one of several laws; which one is not observed.

    p(e_n) = sum_k q_k p_k(e_n)

Every mixture contains plain noise and *wide rows*: their noise is several times wider in all outputs, or in those of
one body, without a direction. A named law must explain rows better than these do. Its own components are plain noise
about a shift along given directions, with amplitude 1 or a normal amplitude; or its noise grows with the motion. Fitted
by expectation maximisation [Dempster, Laird & Rubin 1977].
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import isotonic_regression

from simgap.diagnosis.config import Z95
from simgap.diagnosis.inference.noise.row_mixture_em import (
    RENEWED,
    WIDE,
    Law,
    Mixture,
    expectation,
    maximisation,
    without_plain,
)
from simgap.diagnosis.likelihood.student_t import Noise

ITERATIONS = 40
"""Maximum number of steps of expectation maximisation."""
CONVERGED = 0.05
"""Fitting stops when a step gains less than this [nats]."""
REFITTED = 20
"""Steps in which shares are refitted without a block."""


def of_plain(noise: Noise, groups: tuple[Int[np.ndarray, " g"], ...]) -> Mixture:
    """Starting point of the fit of a law without shifts."""
    wide = len(groups) * len(WIDE)
    shares = np.full(1 + wide, 0.02 / max(wide, 1))
    shares[0] = 1 - shares[1:].sum()
    return Mixture(shares, noise)


def without_shifts(mixture: Mixture, number: int) -> Mixture:
    """The mixture with the shares of its last `number` components moved to the plain one."""
    shares = mixture.shares[: len(mixture.shares) - number].copy()
    shares[0] += 1 - shares.sum()
    return Mixture(shares, mixture.noise)


def with_shifts(mixture: Mixture, shares: Float[np.ndarray, " j"]) -> Mixture:
    """The mixture with further components of these shares, which reduce the others."""
    return mixture._replace(shares=np.concatenate([mixture.shares * (1 - shares.sum()), shares]))


def fitted(law: Law, e: Float[np.ndarray, "n s"], start: Mixture) -> tuple[Mixture, Float[np.ndarray, " n"]]:
    """The most likely constants, and ln p of every row with them."""
    mixture, previous = start, -np.inf
    if law.everywhere:
        mixture = mixture._replace(shares=without_plain(mixture.shares))
    expected = expectation(law, e, mixture)
    for step in range(ITERATIONS):
        current = float(expected.density.sum())
        if current - previous < CONVERGED and step >= RENEWED:
            break
        previous = current
        mixture = maximisation(law, mixture, expected, step % RENEWED == RENEWED - 1)
        expected = expectation(law, e, mixture)
    return mixture, expected.density


def density(law: Law, e: Float[np.ndarray, "n s"], mixture: Mixture) -> Float[np.ndarray, " n"]:
    """ln p of every row."""
    return expectation(law, e, mixture).density


def interval(
    law: Law,
    e: Float[np.ndarray, "n s"],
    mixture: Mixture,
    starts: Int[np.ndarray, " B"],
    constant: Callable[[Mixture], float],
) -> list[float]:
    """95 % interval of a positive constant, given as a function of the mixture.

    On a log scale, with all other constants free, by the likelihood's own variance or the sandwich over blocks of rows
    [White 1982], whichever is larger.
    """
    x = expectation(law, e, mixture)
    kept = np.flatnonzero(mixture.shares * len(e) >= 1)[1:]
    columns = [x.chance[:, k] - mixture.shares[k] for k in kept]
    moved = [_moved_share(mixture, k) for k in kept]
    columns += [*x.by_scale.T]
    moved += [lambda h, j=j: _moved_scale(mixture, j, h) for j in range(e.shape[1])]
    if law.free:
        columns.append(x.by_sd)
        moved.append(lambda h: mixture._replace(sd=mixture.sd * np.exp(h)))
    if law.moving is not None:
        columns.append(x.by_slope)
        moved.append(lambda h: mixture._replace(slope=mixture.slope * np.exp(h)))
    h, value = 1e-4, constant(mixture)
    gradient = np.array([(np.log(constant(m(h))) - np.log(constant(m(-h)))) / (2 * h) for m in moved])
    score = np.stack(columns, axis=1)
    inverse = np.linalg.pinv(score.T @ score, hermitian=True)
    block = np.add.reduceat(score, starts, axis=0)
    along = inverse @ gradient
    return _on_log_scale(value, np.sqrt(max(float(gradient @ along), float(((block @ along) ** 2).sum()))))


def burst_interval(
    law: Law,
    e: Float[np.ndarray, "n s"],
    mixture: Mixture,
    starts: Int[np.ndarray, " B"],
    constant: Callable[[Mixture], float],
) -> list[float]:
    """95 % interval of a positive constant that depends on the shares of bursts, which stay in falling order.

    On a log scale, by the jackknife over blocks of rows: the shares are refitted without each block [Efron 1981].
    """
    number = len(law.shifts)
    chance, size = expectation(law, e, mixture).chance, np.diff(np.append(starts, len(e)))
    grouped = np.column_stack([chance[:, :-number].sum(1), chance[:, -number:]])
    at = np.append(mixture.shares[:-number].sum(), mixture.shares[-number:])
    ratio = grouped / np.maximum(at, 1e-12)  # density of every component over that of the row
    shares, own = np.tile(at, (len(starts), 1)), np.repeat(np.arange(len(starts)), size)
    for _ in range(REFITTED):
        mean = ratio @ shares.T
        total = shares * (ratio.T @ (1 / mean)).T
        without = np.add.reduceat(ratio / mean[np.arange(len(e)), own][:, None], starts) * shares
        shares = (total - without) / (len(e) - size)[:, None]
        shares[:, 1:] = _falling(shares[:, 1:])
    values = np.log([constant(mixture._replace(shares=s)) for s in shares])
    sd = np.sqrt((len(starts) - 1) / len(starts) * ((values - values.mean()) ** 2).sum())
    return _on_log_scale(constant(mixture), sd)


def _on_log_scale(value: float, sd: float) -> list[float]:
    """95 % interval of a positive value, given the standard deviation of its logarithm."""
    return [float(value * np.exp(-Z95 * sd)), float(value * np.exp(Z95 * sd))]


def _falling(x: Float[np.ndarray, "B k"]) -> Float[np.ndarray, "B k"]:
    """The nearest non-increasing sequence, row by row."""
    return np.stack([isotonic_regression(row, increasing=False).x for row in x])


def _moved_share(mixture: Mixture, k: int) -> Callable[[float], Mixture]:
    def moved(h: float) -> Mixture:
        shares = mixture.shares.copy()
        shares[k] *= np.exp(h)
        return mixture._replace(shares=shares / shares.sum())

    return moved


def _moved_scale(mixture: Mixture, j: int, h: float) -> Mixture:
    scale = mixture.noise.scale.copy()
    scale[j] *= np.exp(h)
    return mixture._replace(noise=Noise(scale, mixture.noise.dof))
