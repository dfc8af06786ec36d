"""A model with a residual as an environment: rows of unequal duration."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from simgap.models import BNN
from simgap.policies.environment import LearntSpot, Situation, Step
from simgap.recordings import Normalisation, encode_state
from simgap.residual.model import predict
from simgap.simulators.spot import SCHEMA


@partial(jax.tree_util.register_dataclass, data_fields=("model", "box"), meta_fields=("config", "bounds"))
@dataclass(frozen=True)
class ResidualSpot(LearntSpot):
    """As `LearntSpot`, in a `ResidualModel`: an episode follows one particle, and every row draws its own duration."""

    def step(self, state: Situation, action: Float[Array, " 6"], key: PRNGKeyArray) -> Step:
        """See `Environment`."""
        key_duration, key = jax.random.split(key)
        command = jnp.array(self.config.command_limit) * action
        x = jnp.concatenate([encode_state(SCHEMA, state.state), state.past.reshape(-1), command])
        prediction = predict(self.model, x)  # type: ignore[arg-type]  # a model with a residual
        durations = len(self.model.durations)  # type: ignore[union-attr]  # as above
        drawn = jax.random.randint(key_duration, (), 0, durations)
        mean = prediction.mean.reshape(-1, durations, len(prediction.scale))[:, drawn]
        # What is predicted here, as a model that predicts it everywhere.
        weight = jnp.zeros((len(mean), len(x), mean.shape[1]))
        x_zero, y_zero = jnp.zeros(len(x)), jnp.zeros(mean.shape[1])
        units = Normalisation(x_zero, x_zero + 1, y_zero, y_zero + 1)
        here = BNN([(weight, mean[:, None])], prediction.scale, prediction.dof, units)
        return LearntSpot.step(replace(self, model=here), state, action, key)
