"""mu, the distribution that measurement points are drawn from [Hoffman et al. 2025, Function Space Inference]."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from simgap.recordings import decode_state, encode_state
from simgap.types import Simulator


@partial(jax.jit, static_argnames=("count", "simulator"))
def uniform_inputs(
    key: PRNGKeyArray, count: int, x_train: Float[Array, "n x"], simulator: Simulator
) -> Float[Array, "count x"]:
    """Points uniform in the box that the training inputs span, in the simulator's body coordinates.

    The paper leaves mu open but for its support. A box holds inputs that no recording holds, where the prior is to
    have the say; in body coordinates it holds none that the robot cannot reach (in world coordinates most of it would
    have the hand metres away from the base).
    """
    schema = simulator.schema
    encoded = len(schema.encoded)
    body = jax.vmap(lambda x: simulator.to_body(decode_state(schema, x[:encoded])))(x_train)
    coordinates = jnp.concatenate([body, x_train[:, encoded:]], axis=1)
    shape = (count, coordinates.shape[1])
    drawn = jax.random.uniform(key, shape, minval=coordinates.min(0), maxval=coordinates.max(0))
    states = len(schema.state)
    world = jax.vmap(lambda c: encode_state(schema, simulator.from_body(c[:states])))(drawn)
    return jnp.concatenate([world, drawn[:, states:]], axis=1)
