"""Soft actor-critic on the swing-up of a pendulum, against a published return.

The task is Gymnasium's Pendulum-v1 (gymnasium.farama.org, its documentation of classic control), written out: a rod
of 1 m and 1 kg, g = 10 m/s², torques up to 2 N m, speeds up to 8 rad/s, 200 steps of 0.05 s, cost
theta² + 0.1 omega² + 0.001 torque² with theta = 0 upright.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import pytest
from jaxtyping import Array, Float, PRNGKeyArray

from simgap.policies import learn, sac
from simgap.policies.environment import Step

EPISODE = 200
PUBLISHED, SPREAD, EPISODES = -157.0, 88.7, 750
"""SAC's mean return on Pendulum-v1 after 20,000 steps, the standard deviation between episodes, and their number:
benchmark.md of the repository DLR-RM/rl-baselines3-zoo."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pendulum:
    """theta from upright [rad], omega [rad/s]; an action of 1 is the greatest torque."""

    torque: Float[Array, ""]

    @property
    def action_size(self) -> int:
        return 1

    def reset(self, key: PRNGKeyArray) -> Array:
        return jax.random.uniform(key, (2,), minval=jnp.array([-jnp.pi, -1.0]), maxval=jnp.array([jnp.pi, 1.0]))

    def observe(self, state: Array) -> Array:
        return jnp.array([jnp.cos(state[0]), jnp.sin(state[0]), state[1]])

    def step(self, state: Array, action: Array, key: PRNGKeyArray) -> Step:  # noqa: ARG002
        theta, omega = state
        torque = self.torque * jnp.clip(action[0], -1.0, 1.0)
        angle = jnp.arctan2(jnp.sin(theta), jnp.cos(theta))
        cost = angle**2 + 0.1 * omega**2 + 0.001 * torque**2
        omega = jnp.clip(omega + 0.05 * (15.0 * jnp.sin(theta) + 3.0 * torque), -8.0, 8.0)
        return Step(jnp.array([theta + 0.05 * omega, omega]), -cost, jnp.bool_(False))


@pytest.mark.long
def test_a_pendulum_is_swung_up_as_well_as_is_published() -> None:
    task = Pendulum(jnp.float32(2.0))
    rates = {"learning_rate_alpha": 1e-3, "learning_rate_policy": 1e-3, "learning_rate_q": 1e-3}
    config = sac.Config(
        **rates, max_gradient_norm=100.0, discounting=0.98, batch_size=64, tau=0.01, target_entropy=-1.0,
        policy_hidden_layers=(64, 64), critic_hidden_layers=(64, 64),
    )  # fmt: skip
    size = learn.Config(
        environment_steps=21_504, episode_length=EPISODE, steps_between_updates=16, environments=64, updates=1024,
        min_replay=1024, max_replay=50_000, evaluations=4, evaluation_environments=512, plateau=0, plateau_gain=0.0,
    )  # fmt: skip
    curve: list[float] = []
    learnt = learn.learn(jax.random.key(0), task, size, config, lambda _, metrics: curve.append(metrics["return"]))
    zeros = jax.tree.map(jnp.zeros_like, learnt.layers)
    hanging, _ = learn.evaluate(learnt._replace(layers=zeros), task, jax.random.key(1), size)
    assert float(hanging) < -1000.0, "the task must reward control"
    found = float(learn.evaluate(learnt, task, jax.random.key(2), size)[0])
    error = SPREAD * (1 / EPISODES + 1 / size.evaluation_environments) ** 0.5
    assert found > PUBLISHED - 3 * error
    assert found == pytest.approx(max(curve), abs=4 * SPREAD / size.evaluation_environments**0.5)
