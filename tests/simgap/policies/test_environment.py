"""Learnt dynamics as an environment: what follows a command, noise, particles, the edge of what is known."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from tiny_policies import BOUNDS, BOX, LIMIT, WHOLE, kinematic, spot

from simgap.models import BNN, predict
from simgap.networks import init
from simgap.policies.actor import observation
from simgap.policies.environment import LearntSpot, box, draw_noise
from simgap.policies.follow import collision
from simgap.policies.reward import reward
from simgap.recordings import Normalisation, encode_state
from simgap.simulators.spot import SCHEMA, rotation, step, to_body
from simgap.types import Prediction

QUIET = dataclasses.replace(WHOLE, noise=0.0)
ACTION = jnp.array([0.5, -0.5, 1.0, 0.2, -1.0, 0.0])


def test_a_step_is_the_models_and_the_command_enters_the_history() -> None:
    model = kinematic()
    env = LearntSpot(model, BOX, QUIET)
    start = env.reset(jax.random.key(0))
    after, gained, lost = env.step(start, ACTION, jax.random.key(1))
    command = jnp.array(LIMIT) * ACTION
    expected = step(model.params, start.state, command, 1 / 15)
    np.testing.assert_allclose(encode_state(SCHEMA, after.state), encode_state(SCHEMA, expected), atol=1e-5)
    np.testing.assert_allclose(after.past, jnp.stack([start.past[1], command]), rtol=1e-6)
    assert float(gained) == pytest.approx(float(reward(start.state, start.goal, command, WHOLE.reward)))
    assert not lost


def test_a_bnn_gets_its_31_inputs_in_order_and_follows_one_particle() -> None:
    particles = init(jax.random.key(0), 5, (31, 16, 13))
    stats_ = Normalisation(jnp.zeros(31), jnp.ones(31), jnp.zeros(13), jnp.full(13, 0.01))
    model = BNN(particles, jnp.full(13, 1e-3), jnp.full(13, 3.0), stats_)
    env = LearntSpot(model, BOX, QUIET)
    followed = set()
    for seed in range(20):
        start = env.reset(jax.random.key(seed))
        command = jnp.array(LIMIT) * ACTION
        x = jnp.concatenate([encode_state(SCHEMA, start.state), start.past[0], start.past[1], command])
        means = predict(model, x).mean
        change = encode_state(SCHEMA, env.step(start, ACTION, jax.random.key(1)).state.state) - x[:13]
        errors = np.abs(np.asarray(means - change))[:, [0, 1, *range(4, 13)]].max(1)  # the angle is on its circle
        followed.add(int(errors.argmin()))
        assert errors.min() < 1e-5
        assert errors.argmin() == int(start.particle * 5)
    assert len(followed) > 2


@pytest.mark.parametrize("dof", [np.inf, 2.5])
def test_noise_is_drawn_from_the_predictive_distribution(dof: float) -> None:
    prediction = Prediction(jnp.zeros((1, 2)), jnp.array([0.5, 2.0]), jnp.full(2, dof))
    drawn = np.asarray(jax.vmap(lambda key: draw_noise(key, prediction))(jax.random.split(jax.random.key(0), 4000)))
    law = stats.norm if np.isinf(dof) else stats.t(dof)
    for column, scale in zip(drawn.T, (0.5, 2.0), strict=True):
        assert stats.kstest(column / scale, law.cdf).pvalue > 0.01


def test_episodes_begin_in_the_box_of_the_recordings_with_goals_about_the_hand() -> None:
    start = jax.vmap(spot(kinematic(), WHOLE).reset)(jax.random.split(jax.random.key(0), 2000))
    body = jax.vmap(to_body)(start.state)
    np.testing.assert_allclose(body.min(0), BOX.state_low, atol=0.02)
    np.testing.assert_allclose(body.max(0), BOX.state_high, atol=0.02)
    distance = np.asarray(start.goal - start.state[:, 6:9])
    assert np.abs(distance[:, :2]).max() == pytest.approx(1.0, abs=0.01)
    assert (start.goal[:, 2].min(), start.goal[:, 2].max()) == pytest.approx((0.2, 1.0), abs=0.01)


@pytest.mark.long
def test_within_bounds_an_episode_begins_there_and_is_lost_where_a_run_would_be_stopped() -> None:
    keys = jax.random.split(jax.random.key(0), 1000)
    near = BOX._replace(state_low=BOX.state_low.at[6].set(0.1))
    free, bound = (LearntSpot(kinematic(), near, dataclasses.replace(QUIET, escape=1e6), b) for b in (None, BOUNDS))
    stopped = [[bool(collision(np.asarray(s), BOUNDS)) for s in jax.vmap(e.reset)(keys).state] for e in (free, bound)]
    assert np.mean(stopped[0]) > 0.1
    assert not any(stopped[1])

    begun = jax.vmap(bound.reset)(keys)
    actions = jax.random.uniform(jax.random.key(1), (1000, 6), minval=-1.0)
    unbound, after = (jax.vmap(env.step)(begun, actions, keys) for env in (free, bound))
    assert not unbound.lost.any()
    assert 0.01 < after.lost.mean() < 0.9
    np.testing.assert_array_equal(after.lost, [bool(collision(np.asarray(s), BOUNDS)) for s in unbound.state.state])


def test_the_box_is_what_recordings_span_in_the_bases_frame() -> None:
    drawn = jax.vmap(spot(kinematic()).reset)(jax.random.split(jax.random.key(0), 500))
    x = jnp.concatenate([jax.vmap(lambda s: encode_state(SCHEMA, s))(drawn.state), jnp.zeros((500, 12)),
                         drawn.past[:, 0]], axis=1)  # fmt: skip
    found = box(x)
    np.testing.assert_allclose(found.state_low, jax.vmap(to_body)(drawn.state).min(0), atol=1e-4)
    np.testing.assert_allclose(found.command_high, drawn.past[:, 0].max(0), rtol=1e-6)


@pytest.mark.parametrize("broken", [np.nan, np.inf, 50.0])
def test_what_leaves_the_known_world_is_lost_and_not_passed_on(broken: float) -> None:
    """A model that explodes or gives no number ends the episode; the state stays one that can be computed with."""
    model = kinematic()
    env = spot(model._replace(params=model.params.at[9].set(broken)))
    start = env.reset(jax.random.key(0))
    after, _, lost = env.step(start, ACTION, jax.random.key(1))
    assert lost
    np.testing.assert_array_equal(after.state, start.state)


def test_observations_know_no_world_frame_but_the_robots_own() -> None:
    state = jnp.array([1.0, 2.0, 0.5, 0.1, 0.2, 0.3, 1.8, 2.1, 0.6, 0.0, 0.1, 0.2])
    past, goal = jnp.arange(12.0).reshape(2, 6), jnp.array([2.0, 2.5, 0.9])
    here = observation(state, past, goal)
    R, shift = rotation(jnp.float32(1.3)), jnp.array([-4.0, 3.0, 0.0])
    base = (R @ state[:3].at[2].set(0.0) + shift).at[2].set(state[2] + 1.3)
    moved = jnp.concatenate([base, R @ state[3:6], R @ state[6:9] + shift, R @ state[9:]])
    np.testing.assert_allclose(observation(moved, past, R @ goal + shift), here, atol=1e-5)
    np.testing.assert_allclose(here[9:12], rotation(jnp.float32(0.5)).T @ (goal - state[6:9]), atol=1e-6)
    np.testing.assert_array_equal(here[12:], past.reshape(-1))
