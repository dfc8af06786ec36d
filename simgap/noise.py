"""Likelihood noise with learned parameters: independent per output, Gaussian or heavy-tailed."""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.special import gammaln
from jaxtyping import Array, Float


class NoiseFamily(NamedTuple):
    """A family of noise distributions over one output, its parameters learned in unconstrained form.

    init(y) gives the parameters for y outputs; scale and dof read them back; for Gaussian noise dof is infinite.
    """

    init: Callable[[int], dict[str, Array]]
    scale: Callable[[dict[str, Array]], Float[Array, " y"]]
    dof: Callable[[dict[str, Array]], Float[Array, " y"]]
    log_density: Callable[[dict[str, Array], Float[Array, "... y"]], Float[Array, "... y"]]


INITIAL_SCALE = 0.2
"""Starting noise scale, in units of the outputs' standard deviation (the published implementation's)."""
INITIAL_RAW_DOF = 2.0
"""3.1 degrees of freedom."""


def gaussian_log_density(residual: Float[Array, "... y"], scale: Float[Array, " y"]) -> Float[Array, "... y"]:
    """ln N(r | 0, scale^2), elementwise."""
    return -0.5 * (residual / scale) ** 2 - jnp.log(scale) - 0.5 * jnp.log(2 * jnp.pi)


def student_t_log_density(
    residual: Float[Array, "... y"], scale: Float[Array, " y"], dof: Float[Array, " y"]
) -> Float[Array, "... y"]:
    """ln of Student's t density with location 0, elementwise."""
    constant = gammaln((dof + 1) / 2) - gammaln(dof / 2) - 0.5 * jnp.log(dof * jnp.pi) - jnp.log(scale)
    return constant - (dof + 1) / 2 * jnp.log1p((residual / scale) ** 2 / dof)


def _scale(noise: dict[str, Array]) -> Float[Array, " y"]:
    return jnp.exp(noise["log_scale"])


def _dof(noise: dict[str, Array]) -> Float[Array, " y"]:
    # Above 1, so that the mean exists.
    return 1 + jax.nn.softplus(noise["raw_dof"])


def _constant(outputs: int, value: float) -> Float[Array, " y"]:
    # With a type of its own: one that follows from its first use would have training compiled twice.
    return jnp.full(outputs, value, jnp.float32)


gaussian = NoiseFamily(
    init=lambda y: {"log_scale": _constant(y, math.log(INITIAL_SCALE))},
    scale=_scale,
    dof=lambda noise: jnp.full_like(noise["log_scale"], jnp.inf),
    log_density=lambda noise, r: gaussian_log_density(r, _scale(noise)),
)
"""The paper's noise: i.i.d. Gaussian, learned standard deviation per output."""

student_t = NoiseFamily(
    init=lambda y: {
        "log_scale": _constant(y, math.log(INITIAL_SCALE)),
        "raw_dof": _constant(y, INITIAL_RAW_DOF),
    },
    scale=_scale,
    dof=_dof,
    log_density=lambda noise, r: student_t_log_density(r, _scale(noise), _dof(noise)),
)
"""Heavy tails with learned degrees of freedom per output, for recordings with stalls and slips."""

FAMILIES = {"gaussian": gaussian, "student_t": student_t}
