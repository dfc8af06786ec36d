"""Student's t noise of each output: density, weights and maximum-likelihood fit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln

DOFS = np.array([2.5, 3, 4, 5, 7, 10, 20, 60])
FROM_AFAR, FROM_NEAR = 6, 3
"""EM steps for the scale at the first of these, and at each further one, which starts from the scale before it."""
NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution, in units of its median absolute deviation."""
LEAST = 1e-9
"""Least scale, for outputs that a model predicts exactly."""
FURTHEST = 1e15
"""Decorrelated innovations are clipped to this, so that their squares stay finite in 32 bits."""


class Noise(NamedTuple):
    """Student's t noise of each decorrelated output."""

    scale: Float[np.ndarray, " s"]
    dof: Float[np.ndarray, " s"]


def log_density(e: Float[np.ndarray, "n s"], noise: Noise) -> Float[np.ndarray, "n s"]:
    """ln t(e), elementwise."""
    d = noise.dof
    constant = gammaln((d + 1) / 2) - gammaln(d / 2) - 0.5 * np.log(d * np.pi) - np.log(noise.scale)
    return constant - (d + 1) / 2 * np.log1p((e / noise.scale) ** 2 / d)


def weights(e: Float[np.ndarray, "n s"], noise: Noise) -> Float[np.ndarray, "n s"]:
    """Weights w with d ln t / de = -w e; zero for an innovation whose square overflows."""
    with np.errstate(over="ignore"):
        return (noise.dof + 1) / (noise.dof * noise.scale**2 + e**2)


def fit_noise(e: Float[np.ndarray, "n s"]) -> Noise:
    """The dof of `DOFS` with the greatest likelihood, and its scale. Each fit starts from the previous one's scale."""
    if not len(e):
        return Noise(np.ones(e.shape[1]), np.full(e.shape[1], DOFS[-1]))
    squared = np.maximum(np.clip(e.T.astype(np.float32), -FURTHEST, FURTHEST) ** 2, np.float32(1e-30))
    variance, fits = np.maximum(np.median(squared, axis=-1) * 2, LEAST**2), []
    for dof in DOFS:
        variance, density = _fit_scale(squared, variance, float(dof), FROM_NEAR if fits else FROM_AFAR)
        fits.append((variance, density))
    best = np.array([density for _, density in fits]).argmax(0)
    return Noise(np.sqrt(np.array([v for v, _ in fits])[best, np.arange(e.shape[1])]), DOFS[best])


def _fit_scale(
    squared: Float[np.ndarray, "s n"], variance: Float[np.ndarray, " s"], dof: float, steps: int
) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, " s"]]:
    """Squared scale of t noise with `dof` degrees of freedom, and the mean log-density with it.

    Parameter-expanded EM [Liu, Rubin & Wu 1998]: v <- mean(w x^2) / mean(w) with w = 1 / (dof + x^2 / v), where
    mean(w x^2) = v (1 - dof mean(w)).
    """
    work = np.empty_like(squared)
    for _ in range(steps):
        np.divide(squared, variance[:, None].astype(np.float32), out=work)
        work += np.float32(dof)
        np.reciprocal(work, out=work)
        mean = work.mean(-1, dtype=np.float64)
        variance = variance * np.maximum(1 / mean - dof, 0.0) + LEAST**2
    np.divide(squared, (dof * variance[:, None]).astype(np.float32), out=work)
    tails = np.log1p(work, out=work).mean(-1, dtype=np.float64)
    density = gammaln((dof + 1) / 2) - gammaln(dof / 2) - 0.5 * np.log(dof * np.pi * variance)
    return variance, density - (dof + 1) / 2 * tails
