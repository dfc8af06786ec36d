"""Learning: a goal reached in the true kinematic model, interruption, divergence, plateaus, time limits."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_policies import LEARN, LIMIT, SAC, WHOLE, kinematic, spot

from simgap.policies import learn
from simgap.policies.actor import Actor
from simgap.types import DivergenceError


def ignore(_step: int, _metrics: dict[str, float]) -> None:
    """No report."""


@pytest.mark.long
def test_a_policy_learnt_in_the_kinematic_model_reaches_its_goal_there() -> None:
    env = spot(kinematic(), WHOLE)
    rates = dataclasses.replace(SAC, learning_rate_alpha=3e-3, learning_rate_policy=1e-3, learning_rate_q=1e-3,
                                policy_hidden_layers=(32, 32), critic_hidden_layers=(32, 32))  # fmt: skip
    size = dataclasses.replace(LEARN, environment_steps=20_000, environments=64, steps_between_updates=8, updates=512,
                               episode_length=60, min_replay=2048, max_replay=20_000, evaluations=4,
                               evaluation_environments=64)  # fmt: skip
    learnt = learn.learn(jax.random.key(0), env, size, rates, ignore)
    actor = Actor(*learnt, jnp.array(LIMIT))

    def distances(key: jax.Array) -> jax.Array:
        key, key_start = jax.random.split(key)

        def step(now: object, key: jax.Array) -> tuple[object, jax.Array]:
            command = actor.command(now.state, now.past, now.goal)  # type: ignore[attr-defined]
            after = env.step(now, command / jnp.array(LIMIT), key).state  # type: ignore[arg-type]
            return after, jnp.linalg.norm(after.state[6:9] - after.goal)

        return jax.lax.scan(step, env.reset(key_start), jax.random.split(key, 60))[1]

    distance = np.asarray(jax.jit(jax.vmap(distances))(jax.random.split(jax.random.key(5), 64)))
    assert distance[:, 0].mean() > 0.6
    assert np.median(distance[:, -1]) < 0.2, "the reward is full within 0.15 m"
    assert np.mean(distance[:, -1] < 0.3) > 0.9


def test_learning_begins_with_numbers_of_the_type_that_it_ends_with() -> None:
    """Otherwise it is compiled anew after its first evaluation."""
    begun = jax.eval_shape(lambda key: learn.init(key, spot(kinematic()), LEARN, SAC), jax.random.key(0))
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(begun))


def test_interrupted_learning_goes_on_to_the_same_result() -> None:
    env = spot(kinematic())
    kept: list[dict[str, np.ndarray]] = []
    keep = lambda training: kept.append(learn.to_arrays(jax.tree.map(jnp.copy, training)))  # noqa: E731
    whole = learn.learn(jax.random.key(1), env, LEARN, SAC, ignore, keep=keep)
    assert len(kept) == LEARN.evaluations
    reports: list[int] = []
    first = learn.from_arrays(kept[0], env, LEARN, SAC)
    resumed = learn.learn(jax.random.key(7), env, LEARN, SAC, lambda step, _: reports.append(step), first)
    jax.tree.map(np.testing.assert_array_equal, resumed, whole)
    assert reports == [512, 704], "what lies behind is not done again"


def test_a_model_that_explodes_raises_an_error_that_says_so() -> None:
    """A base that moves by 50 m a step leaves what is known at once."""
    model = kinematic()
    message = "every episode of the last two evaluations was lost at environment step 512"
    with pytest.raises(DivergenceError, match=message):
        learn.learn(jax.random.key(0), spot(model._replace(params=model.params.at[9].set(50.0))), LEARN, SAC, ignore)


def test_weights_that_leave_the_finite_numbers_are_told_as_such() -> None:
    """From weights so large that what they give overflows."""
    env = spot(kinematic())
    training = learn.init(jax.random.key(0), env, LEARN, SAC)
    wild = training._replace(learner=training.learner._replace(weights=1e30 * training.learner.weights))
    with pytest.raises(DivergenceError, match="left the finite numbers before environment step 320"):
        learn.learn(jax.random.key(0), env, LEARN, SAC, ignore, wild)


def test_a_plateau_is_where_returns_no_longer_rise() -> None:
    size = dataclasses.replace(LEARN, plateau=3, plateau_gain=0.05)
    rising, flat = [0.0, 20.0, 40.0, 60.0, 80.0, 100.0], [0.0, 60.0, 100.0, 99.0, 104.0, 98.0]
    assert not learn.at_plateau(rising, size)
    assert learn.at_plateau(flat, size)
    assert not learn.at_plateau(flat, LEARN), "0 evaluations: never"
    assert not learn.at_plateau([0.0, 0.0, 0.0, 0.0], size), "too early to say"


def test_time_limits_are_no_ends_but_lost_episodes_are() -> None:
    """Begun at different times, some of the episodes of 20 steps end within the 8 of the first filling."""
    training = learn.init(jax.random.key(0), spot(kinematic()), LEARN, SAC)
    discounts = training.memory.rows[: LEARN.min_replay, 31]  # after 24 observed, 6 commanded and the reward
    assert int(training.places.clock.min()) < 7
    assert (np.asarray(discounts) == 1.0).all()
    model = kinematic()
    lost = learn.init(jax.random.key(0), spot(model._replace(params=model.params.at[9].set(50.0))), LEARN, SAC)
    assert (np.asarray(lost.memory.rows[: LEARN.min_replay, 31]) == 0.0).all()
