"""The three models on data of a robot that the simulator nearly describes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from simgap import draws, fsvgd, identify, learn, priors, scores
from simgap.domain import uniform_inputs
from simgap.noise import FAMILIES
from simgap.recordings import decode_state
from simgap.simulators import sample_parameters, state_difference
from simgap.simulators.spot import SCHEMA, Spot, to_body
from simgap.types import ConfigError, Transitions

SPOT = Spot()
BNN = fsvgd.Config(
    particles=3, batch_size=32, epochs=1000, max_training_steps=3000, learning_rate=1e-3, weight_decay=1e-3,
    hidden_layer_sizes=(32, 32), likelihood_exponent=1.0, bandwidth_svgd=5.0, validation_share=0.1,
    measurement_sets=64, evaluate_every=250, patience=1000,
)  # fmt: skip
PRIOR = priors.SimulatorConfig(lengthscale=1.0, outputscale=0.2, measurement_points=32, function_samples=64)
SIM = identify.Config(training_steps=2000, learning_rate=3e-3, weight_decay=0.0, evaluate_every=500)


def silent(_step: int, _metrics: dict[str, float]) -> None:
    pass


def rows(count: int, seed: int) -> fsvgd.Data:
    """A robot that follows the kinematic model, its parameters inside the plausible ranges, but for a curved gain."""
    recorded = 0.5 * draws.normal(jax.random.key(0), (200, 31))
    x = uniform_inputs(jax.random.key(seed), count, recorded, SPOT)
    (phi,) = sample_parameters(SPOT, jax.random.key(7), 1)
    y = jax.vmap(lambda x: state_difference(SPOT, phi, x.at[-6:].set(jnp.tanh(x[-6:]))))(x)
    return x, y + 0.01 * draws.normal(jax.random.key(seed + 1), y.shape)


@pytest.mark.long
def test_the_simulators_knowledge_helps_where_data_are_few() -> None:
    data, (x_test, y_test) = rows(150, 1), rows(300, 5)
    noise, key = FAMILIES["gaussian"], jax.random.key(3)
    phi = sample_parameters(SPOT, jax.random.key(4), PRIOR.function_samples)
    models = {
        "sim_model": learn.sim_model(data, SPOT, SIM, noise, silent),
        "fsvgd": learn.fsvgd_model(key, data, SPOT, PRIOR, BNN, noise, silent),
        "sim_fsvgd": learn.sim_fsvgd_model(key, data, SPOT, phi, PRIOR, BNN, noise, silent),
    }
    test = Transitions(x_test, y_test, jnp.zeros(300, int))
    nll = {name: scores.one_step(model, test, SCHEMA.encoded)["nll"] for name, model in models.items()}
    assert nll["sim_fsvgd"] < nll["fsvgd"] - 1.0
    assert all(np.isfinite(value) for value in nll.values())


def test_measurement_points_lie_in_the_box_of_the_body_frame() -> None:
    recorded, _ = rows(100, 1)
    drawn = uniform_inputs(jax.random.key(0), 500, recorded, SPOT)
    body = jax.vmap(lambda x: to_body(decode_state(SCHEMA, x[:13])))
    low, high = body(recorded).min(0), body(recorded).max(0)
    assert (body(drawn) >= low - 1e-4).all()
    assert (body(drawn) <= high + 1e-4).all()
    np.testing.assert_allclose(drawn[:, 2] ** 2 + drawn[:, 3] ** 2, 1.0, atol=1e-5)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: priors.Config(0.0, 1.0, 16), "lengthscale"),
        (lambda: priors.SimulatorConfig(1.0, 1.0, 16, 1), "function_samples"),
        (lambda: identify.Config(0, 1e-3, 0.0, 1), "training_steps"),
    ],
)
def test_impossible_configurations_are_named(make, name) -> None:
    with pytest.raises(ConfigError, match=name):
        make()
