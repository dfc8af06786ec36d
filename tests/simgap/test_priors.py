"""Prior scores against gradients of the densities they belong to."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.stats import multivariate_normal
from jaxtyping import Array

from simgap import priors
from simgap.draws import normal
from simgap.types import DivergenceError, Prior

KEY = jax.random.key(0)


def test_gram_is_a_covariance() -> None:
    K = priors.gram(normal(KEY, (20, 3)), lengthscale=0.7, outputscale=0.5)
    np.testing.assert_allclose(jnp.diag(K), 0.25, rtol=1e-6)
    assert np.linalg.eigvalsh(np.asarray(K, np.float64)).min() > -1e-6


@pytest.mark.parametrize("kind", ["gp", "simulator"])
def test_score_is_the_gradient_of_the_log_density(kind: str) -> None:
    x = normal(KEY, (6, 2))
    h = normal(jax.random.key(1), (3, 6, 4))
    functions = lambda x: jnp.sin(normal(KEY, (50, 1, 4)) * x[None, :, :1] + x[None, :, 1:])  # noqa: E731
    marginals = (
        priors.gp_marginals(4, priors.Config(1.0, 0.8, 6))
        if kind == "gp"
        else priors.simulator_marginals(functions, priors.Config(1.0, 0.3, 6))
    )
    prepared = jax.tree.map(lambda a: a[0], priors.prepare(x[None], marginals))
    mean, covariance = marginals(x)
    covariance = jnp.broadcast_to(covariance, (4, 6, 6)) + priors.JITTER * jnp.eye(6)

    def log_density(h: Array) -> Array:
        return sum(multivariate_normal.logpdf(h[:, i], mean[:, i], covariance[i]) for i in range(4))  # type: ignore[return-value]

    np.testing.assert_allclose(priors.score(prepared, h), jax.vmap(jax.grad(log_density))(h), rtol=2e-2, atol=2e-2)


def test_simulator_moments_are_those_of_its_functions() -> None:
    """h = phi x with phi of mean 2 and variance 0.25: mean 2 x, covariance 0.25 x x' plus the gap's."""
    phi = 2 + 0.5 * normal(KEY, (20_000, 1, 1))
    x = jnp.array([[-1.0], [0.5], [3.0]])
    mean, covariance = priors.simulator_marginals(lambda x: phi * x[None], priors.Config(1.0, 0.2, 3))(x)
    np.testing.assert_allclose(mean, 2 * x, atol=0.05)
    np.testing.assert_allclose(covariance[0], 0.25 * x @ x.T + priors.gram(x, 1.0, 0.2), rtol=0.05, atol=0.02)


def test_prepare_does_the_same_for_every_set() -> None:
    sets = normal(KEY, (5, 4, 2))
    together = priors.prepare(sets, priors.gp_marginals(3, priors.Config(1.0, 1.0, 4)), at_once=2)
    alone = priors.prepare(sets[3:4], priors.gp_marginals(3, priors.Config(1.0, 1.0, 4)))
    np.testing.assert_allclose(together.precision[3], alone.precision[0], rtol=1e-5)


def test_a_covariance_that_is_none_is_named() -> None:
    broken = lambda _: (jnp.zeros((2, 1)), -jnp.eye(2)[None])  # noqa: E731
    with pytest.raises(DivergenceError, match="not positive definite"):
        priors.prepare(jnp.zeros((1, 2, 1)), broken)


def test_prior_is_a_pytree_of_sets() -> None:
    prepared = priors.prepare(normal(KEY, (7, 4, 2)), priors.gp_marginals(3, priors.Config(1.0, 1.0, 4)))
    assert isinstance(prepared, Prior)
    assert prepared.mean.shape == (7, 4, 3)
    assert prepared.precision.shape == (7, 1, 4, 4)
