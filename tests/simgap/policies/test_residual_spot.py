"""A model with a residual as an environment."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_policies import BOX, LIMIT, WHOLE, kinematic

from simgap.networks import init
from simgap.policies.residual_spot import ResidualSpot
from simgap.recordings import encode_state
from simgap.residual.model import ResidualModel, predict
from simgap.simulators.spot import SCHEMA, Spot


@pytest.mark.long
def test_an_episode_follows_one_particle_and_every_row_draws_its_duration() -> None:
    params, durations = kinematic().params, jnp.array([0.5, 1.0, 3.0])
    one, particles = jnp.ones(()), init(jax.random.key(0), 5, (27, 16, 12))
    noise = jnp.full(13, 1e-3), jnp.full(13, 3.0)
    model = ResidualModel(
        Spot(), params, durations, one, one, particles, jnp.zeros(27), jnp.ones(27), jnp.full(12, 0.02), *noise
    )
    env = ResidualSpot(model, BOX, dataclasses.replace(WHOLE, noise=0.0))  # type: ignore[arg-type]
    action = jnp.array([0.5, -0.5, 1.0, 0.2, -1.0, 0.0])
    start = env.reset(jax.random.key(3))
    x = jnp.concatenate([encode_state(SCHEMA, start.state), start.past.reshape(-1), jnp.array(LIMIT) * action])
    means = predict(model, x).mean.reshape(5, 3, 13)[int(start.particle * 5)]
    drawn = set()
    for seed in range(20):
        after, _, lost = env.step(start, action, jax.random.key(seed))
        errors = np.abs(np.asarray(encode_state(SCHEMA, after.state) - x[:13] - means))
        errors = errors[:, [0, 1, *range(4, 13)]].max(1)  # the angle is on its circle
        assert errors.min() < 1e-5
        assert not lost
        drawn.add(int(errors.argmin()))
    assert drawn == {0, 1, 2}
