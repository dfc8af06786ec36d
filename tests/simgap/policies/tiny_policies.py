"""The paper's task in the true kinematic model, and learning in a small size."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
from given import POLICY_SIZES

from simgap.models import FittedSpot
from simgap.policies.environment import Box, Config, LearntSpot
from simgap.simulators.spot import SCHEMA
from tasks.params import load_params

_PARAMS = load_params(Path(__file__).parents[3] / "params.yaml", {"policy": POLICY_SIZES})
LEARN, SAC, ENVIRONMENT = _PARAMS.policy.learning, _PARAMS.policy.sac, _PARAMS.policy.environment
BOUNDS = _PARAMS.track.bounds
WHOLE = dataclasses.replace(ENVIRONMENT, start_motion=1.0)
"""Episodes begin anywhere in the box."""
LIMIT = ENVIRONMENT.command_limit
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
    scales, dof = (jnp.full(outputs, value, jnp.float32) for value in (scale, jnp.inf))
    return FittedSpot(phi, scales, dof, jnp.float32(1 / 15))


def spot(model: FittedSpot, config: Config = ENVIRONMENT) -> LearntSpot:
    """The environment of a model."""
    return LearntSpot(model, BOX, config)
