"""The paper's task in the true kinematic model, and learning in a small size."""

import jax.numpy as jnp

from simgap.models import FittedSpot
from simgap.policies import environment, learn, reward, sac
from simgap.policies.environment import Box, LearntSpot
from simgap.simulators.spot import SCHEMA

LIMIT = (1.0, 0.8, 1.0, 0.8, 0.8, 0.8)
REWARD = reward.Config(state_bound=0.15, state_margin=1.5, state_value=0.1, arm_length=1.3, arm_margin=1.3,
                       arm_value=0.1, base_cost=2.0, ee_cost=0.5, state_weight=1.5, arm_weight=0.01,
                       action_weight=0.1)  # fmt: skip
ENVIRONMENT = environment.Config(
    reward=REWARD,
    command_limit=LIMIT,
    start_motion=1.0,
    goal_distance=1.0,
    goal_height=(0.2, 1.0),
    noise=1.0,
    escape=20.0,
)
SAC = sac.Config(
    learning_rate_alpha=3e-3, learning_rate_policy=1e-3, learning_rate_q=1e-3, max_gradient_norm=100.0,
    discounting=0.99, batch_size=64, tau=0.005, target_entropy=-0.5, policy_hidden_layers=(32, 32),
    critic_hidden_layers=(32, 32),
)  # fmt: skip
LEARN = learn.Config(
    environment_steps=1664, episode_length=40, steps_between_updates=4, environments=16, updates=64,
    min_replay=256, max_replay=2000, evaluations=3, evaluation_environments=16, plateau=0, plateau_gain=0.0,
)  # fmt: skip
BOX = Box(
    jnp.array([-2.0, -2.0, -3.1, -0.5, -0.5, -0.5, 0.5, -0.3, 0.3, -0.5, -0.5, -0.5]),
    jnp.array([2.0, 2.0, 3.1, 0.5, 0.5, 0.5, 1.0, 0.3, 0.9, 0.5, 0.5, 0.5]),
    -jnp.array(LIMIT),
    jnp.array(LIMIT),
)


def kinematic(scale: float = 0.002) -> FittedSpot:
    """The kinematic model in the middle of its ranges; every output with Gaussian noise of that scale."""
    outputs = len(SCHEMA.encoded)
    phi = jnp.concatenate([jnp.full(6, 0.3), jnp.zeros(12), jnp.ones(6)])
    return FittedSpot(phi, jnp.full(outputs, scale), jnp.full(outputs, jnp.inf), jnp.float32(1 / 15))


def spot(model: FittedSpot) -> LearntSpot:
    """The environment of a model."""
    return LearntSpot(model, BOX, ENVIRONMENT)
