"""The baseline of the benchmark of training: the same models trained by a loop in Python."""

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Float, PRNGKeyArray

from benchmarks.timing import Job
from benchmarks.training_problem import Cell, Problem, draw_points, finite
from simgap import fsvgd, networks, priors


def baseline_prior_score(
    marginals: priors.Marginals, x: Float[Array, "k x"], h: Float[Array, "L k y"]
) -> Float[Array, "L k y"]:
    """The prior's score at fresh points: marginals, Cholesky factors and two triangular solves, in the step."""
    mean, covariance = marginals(x)
    o, k = covariance.shape[:2]
    factors = jnp.linalg.cholesky(covariance + priors.JITTER * jnp.eye(k))
    difference = (h - mean).reshape(len(h), k, o, -1).transpose(2, 1, 3, 0)
    solved = jax.vmap(lambda factor, d: cho_solve((factor, True), d))(factors, difference.reshape(o, k, -1))
    return -solved.reshape(difference.shape).transpose(3, 1, 0, 2).reshape(h.shape)


def baseline_step(
    problem: Problem, state: fsvgd.State, batch: fsvgd.Data, points: Float[Array, "k x"]
) -> tuple[fsvgd.State, dict[str, Array]]:
    """`fsvgd.step` with the prior computed in it."""
    (x_batch, y_batch), config, noise = batch, problem.config, problem.noise
    L, b = config.particles, len(x_batch)
    weight = len(problem.training[0]) ** config.likelihood_exponent / b
    x = jnp.concatenate([x_batch, points])
    h, pull_back = jax.vjp(lambda p: networks.apply(p, x), state.particles)
    likelihood, (likelihood_score, noise_score) = jax.value_and_grad(
        lambda h, params: noise.log_density(params, y_batch - h).sum(), argnums=(0, 1)
    )(h[:, :b], state.noise)
    score = baseline_prior_score(problem.marginals, x, h).at[:, :b].add(weight * likelihood_score)
    u = fsvgd.svgd_direction(h.reshape(L, -1), score.reshape(L, -1), config.bandwidth_svgd).reshape(h.shape)
    gradient = (pull_back(-u)[0], jax.tree.map(lambda g: -weight * g / L, noise_score))
    params = (state.particles, state.noise)
    updates, optimiser = fsvgd._optimiser(config).update(gradient, state.optimiser, params)
    particles, noise_params = cast(Any, optax.apply_updates(params, updates))
    return fsvgd.State(particles, noise_params, optimiser), {"train_nll": -likelihood / (L * b)}


def baseline(cell: Cell, steps: int) -> Job:
    """The training loop in Python: gather on the host, dispatch one compiled update; the validation NLL at the end."""
    problem, random = cell.problem, np.random.default_rng(0)
    x, y = map(np.asarray, problem.training)

    @jax.jit
    def update(
        state: fsvgd.State, key: PRNGKeyArray, j: int, batch: fsvgd.Data
    ) -> tuple[fsvgd.State, dict[str, Array]]:
        points = draw_points(problem, jax.random.fold_in(key, j), problem.points)
        return baseline_step(problem, state, batch, points)

    def loop() -> float:
        state = cell.state
        for j in range(steps):
            rows = random.integers(0, len(x), problem.config.batch_size)
            state, _ = update(state, cell.key, j, (x[rows], y[rows]))
        return finite(fsvgd.mixture_nll(state.particles, state.noise, *problem.validation, problem.noise))

    return loop


def differences(cell: Cell) -> dict[str, float]:
    """|ours - baseline| / |ours| on one measurement set: of the prior's score, and of one step's gradient."""
    problem, (x, y) = cell.problem, cell.problem.training
    rows, points, prior = jax.tree.map(lambda a: a[0], cell.sets)
    batch, measured = (x[rows], y[rows]), jnp.concatenate([x[rows], points])
    h = networks.apply(cell.state.particles, measured)
    scores = (priors.score(prior, h), baseline_prior_score(problem.marginals, measured, h))
    ours, _ = fsvgd.step(cell.state, batch, points, prior, len(x), problem.config, problem.noise)
    theirs, _ = jax.jit(lambda state: baseline_step(problem, state, batch, points))(cell.state)
    # Adam's first moment after one step is the gradient, scaled.
    gradients = [optax.tree_utils.tree_get(state.optimiser, "mu") for state in (ours, theirs)]
    return {"prior_score": relative_difference(*scores), "gradient": relative_difference(*gradients)}


def relative_difference(a: Any, b: Any) -> float:
    """|a - b| / |a| over all leaves."""
    a, b = ravel_pytree(a)[0], ravel_pytree(b)[0]
    return float(jnp.linalg.norm(a - b) / jnp.linalg.norm(a))
