"""Functional priors, as Gaussian marginals at measurement sets [Hoffman et al. 2025, Function Space Inference].

Nothing here depends on the particles that are trained, so the factors are prepared once for many measurement sets.
All inputs and outputs are normalised.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.types import Prior

JITTER = 1e-4
"""Added to covariances' diagonals, in units of the outputs' variance, so that single precision can factor them."""


def gram(x: Float[Array, "k x"], lengthscale: float, outputscale: float) -> Float[Array, "k k"]:
    """K_ij = nu^2 exp(-||x_i - x_j||^2 / (2 l^2)) [Hoffman et al. 2025, Sim-FSVGD]."""
    squared = jnp.sum((x[:, None] - x[None]) ** 2, axis=-1)
    return outputscale**2 * jnp.exp(-squared / (2 * lengthscale**2))


def _precision(covariance: Float[Array, "o k k"]) -> Float[Array, "o k k"]:
    identity = jnp.eye(covariance.shape[-1])
    factor = jnp.linalg.cholesky(covariance + JITTER * identity)
    return jax.vmap(lambda c: jax.scipy.linalg.cho_solve((c, True), identity))(factor)


def gp_prior(x: Float[Array, "k x"], outputs: int, lengthscale: float, outputscale: float) -> Prior:
    """Zero-mean Gaussian process, independent per output: FSVGD's prior, in closed form."""
    return Prior(jnp.zeros((x.shape[0], outputs)), _precision(gram(x, lengthscale, outputscale)[None]))


def simulator_prior(
    x: Float[Array, "k x"], functions: Float[Array, "P k y"], lengthscale: float, outputscale: float
) -> Prior:
    """Domain-model process plus sim-to-real Gaussian process [Hoffman et al. 2025, Sim-FSVGD].

    `functions` are P simulators, phi ~ p(phi), at the points x. Their mean and covariance are estimated; the
    sim-to-real process adds its covariance in closed form. Per output i: N(mu_i, cov_i + K).
    """
    mean = functions.mean(0)
    centred = functions - mean
    covariance = jnp.einsum("pki,pli->ikl", centred, centred) / (functions.shape[0] - 1)
    return Prior(mean, _precision(covariance + gram(x, lengthscale, outputscale)))


def score(prior: Prior, h: Float[Array, "L k y"]) -> Float[Array, "L k y"]:
    """grad_h ln p(h^X) = -precision_i (h_i - mu_i), per output i."""
    difference = h - prior.mean
    if prior.precision.shape[0] == 1:
        return -jnp.einsum("kl,Lli->Lki", prior.precision[0], difference)
    return -jnp.einsum("ikl,Lli->Lki", prior.precision, difference)


def prepare(
    measurement_sets: Float[Array, "M k x"], prior: Callable[[Float[Array, "k x"]], Prior]
) -> tuple[Float[Array, "M k x"], Prior]:
    """The prior at every measurement set, one set at a time to keep memory small."""
    return measurement_sets, jax.lax.map(prior, measurement_sets)
