"""SIM-MODEL recovers the parameters that made its data."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from simgap import draws, identify
from simgap.domain import uniform_inputs
from simgap.noise import FAMILIES
from simgap.simulators import parameter_ranges, state_difference
from simgap.simulators.spot import Spot

SPOT = Spot()
CONFIG = identify.Config(training_steps=4000, learning_rate=3e-3, weight_decay=0.0, evaluate_every=4000)


@pytest.mark.parametrize("noise", ["gaussian", "student_t"])
def test_planted_parameters_are_recovered(noise: str) -> None:
    low, high = parameter_ranges(SPOT)
    planted = low + (high - low) * jax.random.uniform(jax.random.key(1), (24,))
    recorded = draws.normal(jax.random.key(2), (400, 31)).at[:, 2:4].set(0.5)
    x = uniform_inputs(jax.random.key(3), 400, recorded, SPOT)
    y = jax.vmap(lambda x: state_difference(SPOT, planted, x))(x)
    sigma = 0.02
    y = y + sigma * draws.normal(jax.random.key(4), y.shape)
    nll: list[float] = []
    params, scale, dof = identify.identify(
        SPOT, (x, y), CONFIG, FAMILIES[noise], lambda _, m: nll.append(m["train_nll"])
    )
    np.testing.assert_allclose(params[:6], planted[:6], atol=0.02)
    np.testing.assert_allclose(params[6:18], planted[6:18], atol=0.005)
    np.testing.assert_allclose(params[18:], planted[18:], atol=0.05)
    np.testing.assert_allclose(scale, sigma, rtol=0.2)
    assert (dof > 5).all()
    entropy = 13 * (0.5 * np.log(2 * np.pi) + np.log(sigma) + 0.5)
    assert nll[-1] == pytest.approx(entropy, abs=1.0)


def test_parameters_may_leave_their_ranges_when_data_say_so() -> None:
    low, high = parameter_ranges(SPOT)
    planted = jnp.asarray((low + high) / 2).at[18].set(3.0)  # gamma_1 of a recording at 5 Hz
    recorded = draws.normal(jax.random.key(2), (400, 31))
    x = uniform_inputs(jax.random.key(3), 400, recorded, SPOT)
    y = jax.vmap(lambda x: state_difference(SPOT, planted, x))(x)
    y = y + 0.01 * draws.normal(jax.random.key(4), y.shape)
    params, _, _ = identify.identify(SPOT, (x, y), CONFIG, FAMILIES["gaussian"], lambda *_: None)
    assert params[18] == pytest.approx(3.0, abs=0.1)
