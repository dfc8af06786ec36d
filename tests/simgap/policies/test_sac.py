"""Soft actor-critic: its parts against closed forms, and a linear-quadratic task against Riccati's solution."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float, PRNGKeyArray
from scipy import stats

from simgap.policies import learn, replay, sac
from simgap.policies.environment import Step

CONFIG = sac.Config(
    learning_rate_alpha=3e-3, learning_rate_policy=3e-3, learning_rate_q=3e-3, max_gradient_norm=100.0,
    discounting=0.99, batch_size=64, tau=0.005, target_entropy=-0.5, policy_hidden_layers=(64, 64),
    critic_hidden_layers=(64, 64),
)  # fmt: skip
LEARN = learn.Config(
    environment_steps=22_528, episode_length=30, steps_between_updates=16, environments=64, updates=1024,
    min_replay=2048, max_replay=50_000, evaluations=5, evaluation_environments=64, plateau=0, plateau_gain=0.0,
)  # fmt: skip


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinearQuadratic:
    """x' = A x + B (2 action) + noise; reward -(x^T Q x + R (2 action)^2)."""

    A: Float[Array, "2 2"]
    B: Float[Array, "2 1"]

    @property
    def action_size(self) -> int:
        return 1

    def reset(self, key: PRNGKeyArray) -> Array:
        return jax.random.uniform(key, (2,), minval=-1.0)

    def observe(self, state: Array) -> Array:
        return state

    def step(self, state: Array, action: Array, key: PRNGKeyArray) -> Step:
        cost = state @ Q @ state + R * jnp.sum((2 * action) ** 2)
        following = self.A @ state + self.B @ (2 * action) + 0.02 * jax.random.normal(key, (2,))
        return Step(following, -cost, jnp.bool_(False))


Q, R, GAMMA = jnp.diag(jnp.array([5.0, 0.5])), 0.5, CONFIG.discounting
TASK = LinearQuadratic(jnp.array([[0.95, 0.2], [0.0, 0.9]]), jnp.array([[0.02], [0.2]]))


def riccati() -> np.ndarray:
    """K of the optimal u = -K x of the discounted task."""
    A, B, P = np.asarray(TASK.A, float), np.asarray(TASK.B, float), np.asarray(Q, float)
    for _ in range(2000):
        K = GAMMA * np.linalg.solve(R + GAMMA * B.T @ P @ B, B.T @ P @ A)
        P = np.asarray(Q) + GAMMA * A.T @ P @ (A - B @ K)
    return K


def mean_return(act: object) -> float:
    """Of an action as a function of the state, over 30 steps from 256 starts."""

    def run(key: PRNGKeyArray) -> Array:
        key, key_start = jax.random.split(key)

        def step(state: Array, key: PRNGKeyArray) -> tuple[Array, Array]:
            following, reward, _ = TASK.step(state, act(state), key)  # type: ignore[operator]
            return following, reward

        return jax.lax.scan(step, TASK.reset(key_start), jax.random.split(key, 30))[1].sum()

    return float(jax.vmap(run)(jax.random.split(jax.random.key(9), 256)).mean())


@pytest.mark.long
def test_a_linear_quadratic_task_is_solved_as_riccati_does() -> None:
    curve: list[float] = []
    learnt = learn.learn(jax.random.key(0), TASK, LEARN, CONFIG, lambda _, metrics: curve.append(metrics["return"]))
    K = jnp.asarray(riccati(), jnp.float32)
    optimal = mean_return(lambda x: jnp.clip(-K @ x / 2, -1, 1))
    ours = mean_return(lambda x: sac.exploit(learnt.layers, (x - learnt.mean) / learnt.std))
    nothing = mean_return(lambda _: jnp.zeros(1))
    assert nothing < 3 * optimal, "the task must reward control"
    assert ours > 1.08 * optimal
    assert len(curve) == LEARN.evaluations
    starts = jax.vmap(TASK.reset)(jax.random.split(jax.random.key(3), 200)) / 4  # where no action is clipped
    actions = jax.vmap(lambda x: 2 * sac.exploit(learnt.layers, (x - learnt.mean) / learnt.std))(starts)
    gain = np.linalg.lstsq(np.asarray(starts), -np.asarray(actions[:, 0]), rcond=None)[0]
    np.testing.assert_allclose(gain, np.asarray(K)[0], rtol=0.25)


def drawn(rng: np.random.Generator, *shapes: tuple[int, ...]) -> list[Array]:
    """Standard normal numbers."""
    return [jnp.asarray(rng.normal(size=shape), jnp.float32) for shape in shapes]


def test_density_of_squashed_actions_is_a_change_of_variables() -> None:
    shapes = sac.networks(3, 2, CONFIG)
    layers = sac.actor_layers(jax.jit(sac.init, static_argnums=1)(jax.random.key(0), shapes).weights, shapes)
    observation, normal = drawn(np.random.default_rng(1), (50, 3), (50, 2))
    action, density = sac._draw(layers, observation, normal)
    location, std = map(np.asarray, sac._distribution(layers, observation))
    raw = np.arctanh(np.asarray(action, np.float64))
    expected = stats.norm(location, std).logpdf(raw) - np.log(1 - np.asarray(action, np.float64) ** 2)
    np.testing.assert_allclose(density, expected.sum(1), atol=1e-3)


class Batch(NamedTuple):
    """What the losses are taken of."""

    learner: sac.Learner
    experience: replay.Experience
    normal: Array
    shapes: sac.Networks


@pytest.fixture(scope="module")
def batch() -> Batch:
    shapes = sac.networks(5, 2, CONFIG)
    learner = jax.jit(sac.init, static_argnums=1)(jax.random.key(0), shapes)
    target, weights, observed, acted, normal = drawn(
        np.random.default_rng(0), learner.target.shape, learner.weights.shape, (64, 5), (64, 2), (2, 64, 2)
    )
    # A target of its own, biases that are not zero.
    learner = learner._replace(target=learner.target + 0.1 * target, weights=learner.weights + 0.1 * weights)
    ends = jnp.where(jnp.arange(64) % 4 == 0, 0.0, 1.0)
    experience = replay.Experience(observed, jnp.tanh(acted), observed[:, 0], ends, observed + 0.1)
    return Batch(learner, experience, normal, shapes)


def plain_q(parts: list[Array], critic: int, observation: Array, action: Array) -> Array:
    """One of the two critics, taken out of their common arrays."""
    h = jnp.concatenate([observation, action], axis=1)
    width = parts[0].shape[1] // 2
    columns = slice(critic * width, (critic + 1) * width)
    h = jax.nn.swish(h @ parts[0][:, columns] + parts[1][columns])
    h = jax.nn.swish(h @ parts[2][critic] + parts[3][critic])
    return (h @ parts[4][critic] + parts[5][critic])[:, 0]


def test_fused_critics_are_two_networks(batch: Batch) -> None:
    learner, experience, _, shapes = batch
    critics = learner.weights[shapes.actor_size : -1]
    parts = sac._unpacked(critics, shapes.critics)
    expected = [plain_q(parts, c, experience.observation, experience.action) for c in (0, 1)]
    np.testing.assert_allclose(sac._q(parts, experience.observation, experience.action), expected, rtol=1e-4,
                               atol=1e-5)  # fmt: skip


def test_one_gradient_is_that_of_each_loss_for_its_own_weights(batch: Batch) -> None:
    """Written out loss by loss, each differentiated with respect to what it may move alone."""
    learner, seen, normal, shapes = batch
    a = shapes.actor_size
    actor, critics, log_alpha = learner.weights[:a], learner.weights[a:-1], learner.weights[-1]

    target_parts = sac._unpacked(learner.target, shapes.critics)

    def q_of(critics: Array, action: Array) -> Array:
        return sac._q(sac._unpacked(critics, shapes.critics), seen.observation, action)

    def critic_loss(critics: Array) -> Array:
        action, density = sac._draw(sac.actor_layers(actor, shapes), seen.following, normal[0])
        target = sac._q(target_parts, seen.following, action).min(0) - jnp.exp(log_alpha) * density
        wanted = seen.reward + 0.99 * seen.discount * target
        return sum(0.5 * jnp.mean((q - wanted) ** 2) for q in q_of(critics, seen.action))  # type: ignore[return-value]

    def policy_loss(actor: Array) -> Array:
        action, density = sac._draw(sac.actor_layers(actor, shapes), seen.observation, normal[1])
        return jnp.mean(jnp.exp(log_alpha) * density - q_of(critics, action).min(0))

    def alpha_loss(log_alpha: Array) -> Array:
        _, density = sac._draw(sac.actor_layers(actor, shapes), seen.observation, normal[1])
        return jnp.exp(log_alpha) * jnp.mean(-density + 0.5 * 2)

    expected = jnp.concatenate([
        jax.jit(jax.grad(policy_loss))(actor), jax.jit(jax.grad(critic_loss))(critics),
        jax.jit(jax.grad(alpha_loss))(log_alpha)[None],
    ])  # fmt: skip
    gradient = jax.jit(jax.grad(sac._loss), static_argnums=(4, 5))(
        sac._parts(learner.weights, shapes), target_parts, seen, normal, shapes, CONFIG
    )
    found = jnp.concatenate([part.reshape(-1) for part in jax.tree.leaves(gradient)])
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-5)


def test_an_update_is_adams_and_the_target_trails(batch: Batch) -> None:
    """Adam's first step is the sign of the gradient times the learning rate."""
    learner, seen, normal, shapes = batch
    after = jax.jit(sac.update, static_argnums=(3, 4))(learner, seen, normal, shapes, CONFIG)
    moved = np.abs(np.asarray(after.weights - learner.weights))
    assert np.median(moved) == pytest.approx(3e-3, rel=1e-2)
    assert moved.max() < 3.03e-3
    critics = after.weights[shapes.actor_size : -1]
    np.testing.assert_allclose(after.target, 0.995 * learner.target + 0.005 * critics, rtol=1e-5, atol=1e-7)


def test_the_memory_is_a_ring() -> None:
    memory = replay.init(10, 2, 1)
    for start in (0, 6, 12):
        k = jnp.arange(start, start + 6, dtype=jnp.float32)
        memory = replay.add(memory, replay.Experience(jnp.stack([k, k], 1), k[:, None], k, k, jnp.stack([k, -k], 1)))
    drawn = replay.sample(memory, jax.random.uniform(jax.random.key(0), (500,)), 1)
    assert set(np.asarray(drawn.reward).astype(int)) == set(range(8, 18)), "the last ten are there, all of them"
    np.testing.assert_array_equal(drawn.observation[:, 0], drawn.reward)
    np.testing.assert_array_equal(drawn.following[:, 1], -drawn.reward)
    few = replay.add(replay.init(10, 2, 1), jax.tree.map(lambda a: a[:3] + 1, drawn))
    assert (np.asarray(replay.sample(few, jax.random.uniform(jax.random.key(1), (100,)), 1).reward) > 0).all(), (
        "nothing empty is drawn"
    )
