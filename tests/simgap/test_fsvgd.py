"""FSVGD against a brute-force update, a Gaussian process posterior in closed form, and a simulator's prior."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from simgap import draws, fsvgd, models, priors
from simgap.noise import NoiseFamily, gaussian_log_density
from simgap.recordings import Normalisation
from simgap.types import ConfigError, DivergenceError

SIGMA = 0.1
KNOWN = NoiseFamily(
    init=lambda _y: {},
    scale=lambda _noise: jnp.array([SIGMA]),
    dof=lambda _noise: jnp.array([jnp.inf]),
    log_density=lambda _noise, r: gaussian_log_density(r, jnp.array([SIGMA])),
)
"""Noise of a known scale: then the Gaussian process posterior is known as well."""
NEUTRAL = Normalisation(jnp.zeros(1), jnp.ones(1), jnp.zeros(1), jnp.ones(1))
CONFIG = fsvgd.Config(
    particles=20, batch_size=8, epochs=10_000, max_training_steps=4000, learning_rate=3e-3, weight_decay=0.0,
    hidden_layer_sizes=(32, 32), likelihood_exponent=1.0, bandwidth_svgd=0.5, validation_share=0.1,
    measurement_sets=256, evaluate_every=1000, patience=4000,
)  # fmt: skip


def silent(_step: int, _metrics: dict[str, float]) -> None:
    pass


def predictions(model: models.BNN, x: Float[Array, " n"]) -> Float[np.ndarray, "L n"]:
    return np.asarray(jax.vmap(lambda x: models.predict(model, x[None]).mean[:, 0], out_axes=1)(x))


def fit(x: Array, y: Array, marginals: priors.Marginals, low: float, high: float) -> models.BNN:
    points = jax.random.uniform(jax.random.key(2), (CONFIG.measurement_sets, 16, 1), minval=low, maxval=high)
    data = (x[:, None], y[:, None])
    return fsvgd.train(jax.random.key(0), (data, data), NEUTRAL, points, marginals, CONFIG, KNOWN, silent)


def test_direction_is_the_papers_sum() -> None:
    h, score = draws.normal(jax.random.key(0), (2, 4, 6))
    k = lambda a, b: jnp.exp(-jnp.sum((a - b) ** 2) / (2 * 1.5**2))  # noqa: E731
    brute = [sum(k(h[i], h[j]) * score[j] + jax.grad(k)(h[j], h[i]) for j in range(4)) / 4 for i in range(4)]
    np.testing.assert_allclose(fsvgd.svgd_direction(h, score, 1.5), jnp.stack(brute), rtol=1e-4, atol=1e-6)


def test_particles_repel_where_nothing_pulls() -> None:
    h = jnp.array([[0.0], [0.1]])
    u = fsvgd.svgd_direction(h, jnp.zeros_like(h), 1.0)
    assert u[0] < 0 < u[1]


def test_particles_follow_the_gaussian_process_posterior() -> None:
    """Mean within half a posterior std (0.15 near data), and uncertainty that grows where no data are."""
    x = jnp.array([-1.5, -1.2, -0.9, -0.5, 0.4, 0.7, 1.0, 1.4])
    y = jnp.sin(2 * x)
    marginals = priors.gp_marginals(1, priors.Config(0.6, 1.0, 16))
    model = fit(x, y, marginals, -2.5, 2.5)

    at = jnp.linspace(-1.5, 1.4, 30)
    K = lambda a, b: np.exp(-((a[:, None] - b[None]) ** 2) / (2 * 0.6**2))  # noqa: E731
    gain = K(at, x) @ np.linalg.inv(K(x, x) + SIGMA**2 * np.eye(len(x)))
    mean = gain @ y
    h = predictions(model, at)
    assert np.abs(h.mean(0) - mean).mean() < 0.12
    assert np.abs(h.mean(0) - mean).max() < 0.3
    near, far = predictions(model, x).std(0).mean(), predictions(model, jnp.array([-2.4, 2.4])).std(0).mean()
    assert far > 3 * near


def test_sim_fsvgd_follows_prior_far_from_data_and_data_near_them() -> None:
    """Simulators y = phi x, phi in [0.8, 1.2]; the robot is y = x + 0.5 where it was seen."""
    x = jnp.linspace(-1.0, 0.0, 8)
    phi = jax.random.uniform(jax.random.key(5), (256, 1, 1), minval=0.8, maxval=1.2)
    marginals = priors.simulator_marginals(lambda x: phi * x[None], priors.Config(0.4, 0.2, 16))
    model = fit(x, x + 0.5, marginals, -1.0, 3.0)
    np.testing.assert_allclose(predictions(model, x).mean(0), x + 0.5, atol=0.15)
    far = jnp.array([2.0, 2.5, 3.0])
    np.testing.assert_allclose(predictions(model, far).mean(0), far, atol=0.5)


def test_training_is_deterministic_given_its_key() -> None:
    x = jnp.linspace(-1, 1, 8)
    config_args = (priors.gp_marginals(1, priors.Config(0.5, 1.0, 16)), -1.0, 1.0)
    a, b = fit(x, x, *config_args), fit(x, x, *config_args)
    for left, right in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(left, right)


def test_divergence_is_reported() -> None:
    x = jnp.array([0.0, 1.0, jnp.nan, 2.0, 1.0, 1.0, 1.0, 1.0])
    with pytest.raises(DivergenceError, match="diverged"):
        fit(jnp.linspace(-1, 1, 8), x, priors.gp_marginals(1, priors.Config(0.5, 1.0, 16)), -1.0, 1.0)


def test_measurement_sets_cover_the_data_evenly() -> None:
    points = jnp.zeros((10, 3, 1))
    sets = fsvgd.measurement_sets(
        jax.random.key(0),
        jnp.arange(20.0)[:, None],
        points,
        priors.gp_marginals(1, priors.Config(1.0, 1.0, 3)),
        batch_size=4,
    )
    assert sets.batch.shape == (10, 4)
    assert np.unique(np.asarray(sets.batch), return_counts=True)[1].tolist() == [2] * 20
    assert sets.prior.precision.shape == (10, 1, 7, 7)


def test_steps_are_epochs_times_n_up_to_the_cap() -> None:
    config = fsvgd.Config(5, 64, 100, 200_000, 1e-3, 1e-3, (64,), 1.0, 5.0, 0.1, 1, 1, 1)
    assert config.training_steps(1000) == 100_000
    assert config.training_steps(5000) == 200_000


def test_impossible_hyperparameters_are_named() -> None:
    with pytest.raises(ConfigError, match="particles is 0"):
        fsvgd.Config(0, 64, 100, 200_000, 1e-3, 1e-3, (64,), 1.0, 5.0, 0.1, 1, 1, 1)
