"""Student's t noise of each output: density, weights and maximum-likelihood fit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln

DOFS = np.array([2.5, 3, 4, 5, 7, 10, 20, 60])
FROM_AFAR, FROM_NEAR = 6, 3
"""Steps to the scale of the first of these, and from each one's to the next one's."""
LEAST = 1e-9
"""Least scale, of outputs that a model predicts exactly."""
FURTHEST = 1e15
"""Decorrelated innovations beyond this count as this: their squares stay finite in 32 bits."""


class Noise(NamedTuple):
    """Student's t of each decorrelated output."""

    scale: Float[np.ndarray, " s"]
    dof: Float[np.ndarray, " s"]


def log_density(e: Float[np.ndarray, "n s"], noise: Noise) -> Float[np.ndarray, "n s"]:
    """ln t(e), elementwise."""
    d = noise.dof
    constant = gammaln((d + 1) / 2) - gammaln(d / 2) - 0.5 * np.log(d * np.pi) - np.log(noise.scale)
    return constant - (d + 1) / 2 * np.log1p((e / noise.scale) ** 2 / d)


def weights(e: Float[np.ndarray, "n s"], noise: Noise) -> Float[np.ndarray, "n s"]:
    """w with d ln t / de = -w e: what an innovation counts for; one whose square overflows counts for nothing."""
    with np.errstate(over="ignore"):
        return (noise.dof + 1) / (noise.dof * noise.scale**2 + e**2)


def fit_noise(e: Float[np.ndarray, "n s"]) -> Noise:
    """Scale for every dof of `DOFS`, each from where the one before ended, and the dof of greatest likelihood."""
    if not len(e):
        return Noise(np.ones(e.shape[1]), np.full(e.shape[1], DOFS[-1]))
    squared = np.maximum(np.clip(e.T.astype(np.float32), -FURTHEST, FURTHEST) ** 2, np.float32(1e-30))
    variance, found = np.maximum(np.median(squared, axis=-1) * 2, LEAST**2), []
    for dof in DOFS:
        variance, density = _fit_scale(squared, variance, float(dof), FROM_NEAR if found else FROM_AFAR)
        found.append((variance, density))
    best = np.array([density for _, density in found]).argmax(0)
    return Noise(np.sqrt(np.array([v for v, _ in found])[best, np.arange(e.shape[1])]), DOFS[best])


def _fit_scale(
    squared: Float[np.ndarray, "s n"], variance: Float[np.ndarray, " s"], dof: float, steps: int
) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, " s"]]:
    """Squared scale of t noise with so many degrees of freedom, and the mean log-density with it.

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
