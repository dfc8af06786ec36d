"""Functional Stein variational gradient descent [Hoffman et al. 2025, eq. 2]; Sim-FSVGD is the same with another prior."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from simgap import networks, priors
from simgap.noise import NoiseFamily
from simgap.types import Prior


@dataclass(frozen=True)
class Config:
    """Hyperparameters of the inference [Hoffman et al. 2025, Table 1, General BNN]."""

    particles: int
    batch_size: int
    hidden_layer_sizes: tuple[int, ...]
    learning_rate: float
    weight_decay: float
    bandwidth_svgd: float
    likelihood_exponent: float


class State(NamedTuple):
    """What training carries: L particles, the noise they share, the optimiser."""

    particles: networks.Particles
    noise: dict[str, Array]
    optimiser: Any


def _optimiser(config: Config) -> optax.GradientTransformation:
    # Decay shrinks weights towards a simpler function; shrinking the noise's parameters would state a belief nobody has.
    decay = lambda params: (jax.tree.map(lambda _: True, params[0]), jax.tree.map(lambda _: False, params[1]))  # noqa: E731
    return optax.adamw(config.learning_rate, weight_decay=config.weight_decay, mask=decay)


def init(key: PRNGKeyArray, inputs: int, outputs: int, config: Config, noise: NoiseFamily) -> State:
    """L particles drawn independently."""
    particles = networks.init(key, config.particles, (inputs, *config.hidden_layer_sizes, outputs))
    noise_params = noise.init(outputs)
    return State(particles, noise_params, _optimiser(config).init((particles, noise_params)))


def svgd_direction(h: Float[Array, "L d"], score: Float[Array, "L d"], bandwidth: float) -> Float[Array, "L d"]:
    """u_l = 1/L sum_i [K_li score_i + grad_{h_i} K_li], K_li = exp(-||h_l - h_i||^2 / (2 b^2)) [eq. 2].

    The direction of ascent: the first term pulls every particle towards the posterior, the second pushes them apart.
    """
    squared = jnp.sum((h[:, None] - h[None]) ** 2, axis=-1)
    K = jnp.exp(-squared / (2 * bandwidth**2))
    repulsion = (h * K.sum(1, keepdims=True) - K @ h) / bandwidth**2
    return (K @ score + repulsion) / h.shape[0]


def step(
    state: State,
    batch: tuple[Float[Array, "b x"], Float[Array, "b y"]],
    measurement: tuple[Float[Array, "k x"], Prior],
    n_train: int,
    config: Config,
    noise: NoiseFamily,
) -> tuple[State, dict[str, Array]]:
    """One update theta_l <- theta_l + gamma J_l u_l of all particles, through Adam [eq. 2].

    The measurement set X is the batch together with the k measurement points. On the batch the posterior's score is
    the likelihood's, scaled to the N training points; on the measurement points it is the prior's.
    """
    x_batch, y_batch = batch
    x_measure, prior = measurement
    b = x_batch.shape[0]
    weight = n_train**config.likelihood_exponent / b
    h, pull_back = jax.vjp(lambda p: networks.apply(p, jnp.concatenate([x_batch, x_measure])), state.particles)

    def log_likelihood(h_batch: Float[Array, "L b y"], noise_params: dict[str, Array]) -> Float[Array, ""]:
        return noise.log_density(noise_params, y_batch - h_batch).sum()

    likelihood, (likelihood_score, noise_score) = jax.value_and_grad(log_likelihood, argnums=(0, 1))(
        h[:, :b], state.noise
    )
    posterior_score = jnp.concatenate([weight * likelihood_score, priors.score(prior, h[:, b:])], axis=1)

    L = config.particles
    u = svgd_direction(h.reshape(L, -1), posterior_score.reshape(L, -1), config.bandwidth_svgd).reshape(h.shape)
    (gradient,) = pull_back(-u)
    noise_gradient = jax.tree.map(lambda g: -weight * g / L, noise_score)

    params = (state.particles, state.noise)
    updates, optimiser = _optimiser(config).update((gradient, noise_gradient), state.optimiser, params)
    particles, noise_params = optax.apply_updates(params, updates)
    return State(particles, noise_params, optimiser), {"train_nll": -likelihood / (L * b)}
