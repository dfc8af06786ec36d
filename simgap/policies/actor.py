"""A learnt policy as a whole: from what a robot measures to a command, its normalisation inside."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.simulators.spot import rotation, to_body

Layers = list[tuple[Float[Array, "i o"], Float[Array, " o"]]]


def observation(state: Float[Array, " 12"], past: Float[Array, "2 6"], goal: Float[Array, " 3"]) -> Float[Array, " 24"]:
    """s_cond [Hoffman et al. 2025, Policy Learning] as the robot sees it, and the commands that the delay hides.

    In the base's frame: its velocity [m/s, m/s, rad/s], the hand from it [m], the hand's velocity [m/s], the goal from
    the hand [m]; then u_{t-2}, u_{t-1}. Neither reward nor robot knows where the world frame lies, so the base's pose,
    which the paper's s_cond has, is left out: a policy need not learn that a task is the same elsewhere.
    """
    to_goal = rotation(state[2]).T @ (goal - state[6:9])
    return jnp.concatenate([to_body(state)[3:], to_goal, past.reshape(-1)])


def perceptron(layers: Layers, x: Float[Array, "... i"]) -> Float[Array, "... o"]:
    """Fully connected layers, Swish between them [Hoffman et al. 2025, Table 1]."""
    for weight, bias in layers[:-1]:
        x = jax.nn.swish(x @ weight + bias)
    weight, bias = layers[-1]
    return x @ weight + bias


class Actor(NamedTuple):
    """A tanh-Gaussian policy of soft actor-critic; it commands its mode.

    mean, std: of the observations, which the network takes normalised. limit: the greatest command [m/s, rad/s].
    """

    layers: Layers
    mean: Float[Array, " 24"]
    std: Float[Array, " 24"]
    limit: Float[Array, " 6"]

    def command(
        self, state: Float[Array, " 12"], past: Float[Array, "2 6"], goal: Float[Array, " 3"]
    ) -> Float[Array, " 6"]:
        """See `simgap.types.Policy`."""
        normalised = (observation(state, past, goal) - self.mean) / self.std
        location, _ = jnp.split(perceptron(self.layers, normalised), 2)
        return self.limit * jnp.tanh(location)
