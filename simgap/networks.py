"""Multilayer perceptrons, L particles at a time: lists of (weight, bias) with a leading particle axis."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from simgap import draws

Particles = list[tuple[Float[Array, "L i o"], Float[Array, "L 1 o"]]]


def init(key: PRNGKeyArray, particles: int, sizes: Sequence[int]) -> Particles:
    """LeCun-normal weights, zero biases; `sizes` from input to output."""
    keys = jax.random.split(key, len(sizes) - 1)
    return [
        (draws.normal(k, (particles, i, o)) / jnp.sqrt(i), jnp.zeros((particles, 1, o)))
        for k, i, o in zip(keys, sizes[:-1], sizes[1:], strict=True)
    ]


def apply(params: Particles, x: Float[Array, "k i"]) -> Float[Array, "L k o"]:
    """h_theta(x) of every particle at k points; LeakyReLU between layers [Hoffman et al. 2025, Table 1]."""
    h = jnp.broadcast_to(x, (params[0][0].shape[0], *x.shape))
    for weight, bias in params[:-1]:
        h = jax.nn.leaky_relu(h @ weight + bias)
    weight, bias = params[-1]
    return h @ weight + bias
