"""Functional priors, as Gaussian marginals at measurement sets [Hoffman et al. 2025, Function Space Inference].

Nothing here depends on the particles that are trained, so the marginals are prepared once, for many measurement sets.
All inputs and outputs are normalised.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg.lapack import get_lapack_funcs

from simgap.types import ConfigError, DivergenceError, Prior

JITTER = 1e-4
"""Added to covariances' diagonals, in units of the outputs' variance, so that they can be inverted."""

Marginals = Callable[[Float[Array, "k x"]], tuple[Float[Array, "k y"], Float[Array, "o k k"]]]
"""Mean and covariance of a process at k points; where o = 1, one covariance serves all outputs."""


@dataclass(frozen=True)
class Config:
    """A functional prior [Hoffman et al. 2025, Table 1].

    lengthscale l, on normalised inputs, and outputscale nu, on normalised outputs, of the Gaussian process (for
    Sim-FSVGD the sim-to-real process); measurement points of a set besides the batch.
    """

    lengthscale: float
    outputscale: float
    measurement_points: int

    def __post_init__(self) -> None:
        for name in ("lengthscale", "outputscale", "measurement_points"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be above 0.")


@dataclass(frozen=True)
class SimulatorConfig(Config):
    """With the number of simulators drawn for the prior's moments."""

    function_samples: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.function_samples < 2:
            raise ConfigError(f"function_samples is {self.function_samples}; a covariance needs at least 2.")


def gram(x: Float[Array, "k x"], lengthscale: float, outputscale: float) -> Float[Array, "k k"]:
    """K_ij = nu^2 exp(-||x_i - x_j||^2 / (2 l^2)) [Hoffman et al. 2025, Sim-FSVGD]."""
    squared = jnp.sum((x[:, None] - x[None]) ** 2, axis=-1)
    return outputscale**2 * jnp.exp(-squared / (2 * lengthscale**2))


def gp_marginals(outputs: int, config: Config) -> Marginals:
    """FSVGD's prior: a zero-mean Gaussian process per output, in closed form."""
    return lambda x: (jnp.zeros((x.shape[0], outputs)), gram(x, config.lengthscale, config.outputscale)[None])


def simulator_marginals(functions: Callable[[Float[Array, "k x"]], Float[Array, "P k y"]], config: Config) -> Marginals:
    """Sim-FSVGD's prior: domain-model process plus sim-to-real Gaussian process [Hoffman et al. 2025, Sim-FSVGD].

    `functions` are P simulators, phi ~ p(phi), at the points x. Their mean and covariance are estimated; the
    sim-to-real process adds its covariance in closed form. Per output i: N(mu_i, cov_i + K).
    """

    def marginals(x: Float[Array, "k x"]) -> tuple[Float[Array, "k y"], Float[Array, "y k k"]]:
        h = functions(x)
        mean = h.mean(0)
        centred = h - mean
        covariance = jnp.einsum("pki,pli->ikl", centred, centred) / (h.shape[0] - 1)
        return mean, covariance + gram(x, config.lengthscale, config.outputscale)

    return marginals


def _invert(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """Inverse of a symmetric positive definite matrix, by Cholesky factors in double precision.

    Not jax.numpy.linalg: its LAPACK calls share XLA's thread pool with whatever runs beside them, and two threads
    that train at once dead-lock there (seen with jax 0.10.2).
    """
    factorise, invert = get_lapack_funcs(("potrf", "potri"), (covariance,))
    factor, failed = factorise(covariance, lower=1)
    inverse, failed_inverse = invert(factor, lower=1)
    if failed or failed_inverse:
        raise DivergenceError(
            f"a prior covariance of {len(covariance)} points is not positive definite; its values range from "
            f"{np.min(covariance):.3g} to {np.max(covariance):.3g}. Raise outputscale."
        )
    return np.tril(inverse) + np.tril(inverse, -1).T


def prepare(measurement_sets: Float[Array, "M k x"], marginals: Marginals, at_once: int = 16) -> Prior:
    """The prior at M measurement sets, leading axis M; `at_once` sets are held in double precision at a time.

    Raises DivergenceError where a covariance cannot be inverted.
    """
    compute = jax.jit(lambda sets: jax.lax.map(marginals, sets))
    shapes = jax.eval_shape(compute, measurement_sets)
    mean, precision = (np.empty(shape.shape, np.float32) for shape in shapes)
    for start in range(0, len(measurement_sets), at_once):
        some = slice(start, start + at_once)
        mean[some], covariances = compute(measurement_sets[some])
        for i, outputs in enumerate(np.asarray(covariances, np.float64), start):
            for j, covariance in enumerate(outputs):
                precision[i, j] = _invert(covariance + JITTER * np.eye(len(covariance)))
    return Prior(jnp.asarray(mean), jnp.asarray(precision))


def score(prior: Prior, h: Float[Array, "L k y"]) -> Float[Array, "L k y"]:
    """grad_h ln p(h^X) = -precision_i (h_i - mu_i), per output i."""
    # Outputs lead: in this order of axes XLA's batched product takes a quarter of the time.
    difference = jnp.transpose(h - prior.mean, (2, 1, 0))
    return -jnp.transpose(prior.precision @ difference, (2, 1, 0))
