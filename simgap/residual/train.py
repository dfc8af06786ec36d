"""FSVGD on the residual: what the data show beyond the fitted simulator, under a Gaussian process prior."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from simgap import fsvgd, networks, priors
from simgap.noise import NoiseFamily
from simgap.residual.config import Config
from simgap.residual.fit import Fitted, log_density


class Rows(NamedTuple):
    """Transitions as training needs them: normalised features; what the simulator gives after each duration; the change
    of the outputs by a residual of one unit along each axis; what was measured. Outputs are in units of `y_std`."""

    features: Float[Array, "n f"]
    simulated: Float[Array, "n q y"]
    directions: Float[Array, "n y s"]
    y: Float[Array, "n y"]


class State(NamedTuple):
    """What training carries: L particles, the noise they share, the optimiser."""

    particles: networks.Particles
    noise: dict[str, Array]
    optimiser: Any


def log_densities(
    h: Float[Array, "L n s"], rows: Rows, fitted: Fitted, noise_params: dict[str, Array], noise: NoiseFamily
) -> Float[Array, "L n"]:
    """ln p(y | h) of every particle and row."""
    missed = jnp.einsum("nys,lns->lny", rows.directions, h)
    predicted = rows.simulated + fitted.durations[:, None] * missed[:, :, None]
    return log_density(rows.y[:, None] - predicted, noise_params, noise)


@partial(jax.jit, static_argnames="noise")
def validate(state: State, rows: Rows, fitted: Fitted, noise: NoiseFamily) -> Float[Array, ""]:
    """Mean over rows of -ln p(y | x) under the mixture of particles, in original units."""
    each = log_densities(networks.apply(state.particles, rows.features), rows, fitted, state.noise, noise)
    return -jnp.mean(logsumexp(each, axis=0)) + jnp.log(len(each)) + jnp.log(fitted.y_std).sum()


class Settings(NamedTuple):
    """Of one training: hyperparameters, the prior's scales, the noise."""

    own: Config
    bnn: fsvgd.Config
    outputscale: float
    lengthscale: float
    noise: NoiseFamily


def train(
    key: PRNGKeyArray, rows: Rows, fitted: Fitted, settings: Settings, steps: int, watch: Callable[[int, State], bool]
) -> State:
    """L particles after so many steps, in pieces of `evaluate_every`, after each of which `watch(done, state)` says
    whether to end."""
    own, bnn = settings.own, settings.bnn
    key_init, key_points, key_sets, key_run = jax.random.split(key, 4)
    shape = (bnn.measurement_sets, own.measurement_points, rows.features.shape[1])
    points = jax.random.uniform(key_points, shape, minval=rows.features.min(0), maxval=rows.features.max(0))
    prior = priors.Config(settings.lengthscale, settings.outputscale, own.measurement_points)
    sets = fsvgd.measurement_sets(key_sets, rows.features, points, priors.gp_marginals(1, prior), bnn.batch_size)
    state = init(key_init, rows, fitted, settings)
    for done in range(own.evaluate_every, steps + 1, own.evaluate_every):
        keys = jax.random.fold_in(key_run, done)
        state = _run(state, keys, (rows, fitted, sets), own.evaluate_every, bnn, settings.noise)
        if watch(done, state):
            break
    return state


def init(key: PRNGKeyArray, rows: Rows, fitted: Fitted, settings: Settings) -> State:
    """L particles as small as the prior says, the noise as it was fitted."""
    sizes = (rows.features.shape[1], *settings.bnn.hidden_layer_sizes, rows.directions.shape[2])
    particles = networks.init(key, settings.bnn.particles, sizes)
    weight, bias = particles[-1]
    particles[-1] = (settings.outputscale * weight, bias)
    return State(particles, fitted.noise, optax.adam(settings.bnn.learning_rate).init((particles, fitted.noise)))


@partial(jax.jit, static_argnames=("steps", "config", "noise"))
def _run(
    state: State,
    key: PRNGKeyArray,
    data: tuple[Rows, Fitted, fsvgd.MeasurementSets],
    steps: int,
    config: fsvgd.Config,
    noise: NoiseFamily,
) -> State:
    """`steps` updates, each on a measurement set drawn at random from those prepared."""
    rows, fitted, sets = data
    weight = len(rows.y) / sets.batch.shape[1]

    def body(state: State, j: Int[Array, ""]) -> tuple[State, None]:
        batch, points, prior = jax.tree.map(lambda a: a[j], sets)
        some = jax.tree.map(lambda a: a[batch], rows)
        inputs = jnp.concatenate([some.features, points])
        h, pull_back = jax.vjp(lambda p: networks.apply(p, inputs), state.particles)
        b, L = len(batch), len(h)

        def likelihood(h: Float[Array, "L b s"], noise_params: dict[str, Array]) -> Float[Array, ""]:
            return log_densities(h, some, fitted, noise_params, noise).sum()

        score, noise_score = jax.grad(likelihood, argnums=(0, 1))(h[:, :b], state.noise)
        posterior = priors.score(prior, h).at[:, :b].add(weight * score)
        u = fsvgd.svgd_direction(h.reshape(L, -1), posterior.reshape(L, -1), config.bandwidth_svgd)
        (gradient,) = pull_back(-u.reshape(h.shape))
        noise_gradient = jax.tree.map(lambda g: -weight * g / L, noise_score)
        params = (state.particles, state.noise)
        updates, optimiser = optax.adam(config.learning_rate).update(
            (gradient, noise_gradient), state.optimiser, params
        )
        particles, noise_params = cast(Any, optax.apply_updates(params, updates))
        return State(particles, noise_params, optimiser), None

    return jax.lax.scan(body, state, jax.random.randint(key, (steps,), 0, len(sets.batch)))[0]
