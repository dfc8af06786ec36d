"""What a twin is, and how it moves by one row.

Its state is what the sensors would say if they were not late: a measured position is older than its velocity by the
body's `ages`. A row lasts `duration` steps of the simulator, after which a recorded departure from the model, `missed`,
is added, so a twin that replays a session's commands, durations and departures repeats the session.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.recordings import decode_state, encode_state
from simgap.residual.model import ResidualModel, steady
from simgap.simulators.spot import SCHEMA, rotation

TRIPLES = len(SCHEMA.state) // 3
"""Pose and velocity of the base, position and velocity of the hand: three states each."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=("model", "ages", "durations", "missed", "home", "row_s"),
    meta_fields=(),
)
@dataclass(frozen=True)
class Twin:
    """A fitted model with what was recorded beyond it.

    model: the simulator with its fitted parameters and a residual of one particle. ages: by how much a measured
    position is older than its velocity, of base and hand [s], given how the simulator integrates velocities. durations
    [steps of the simulator] and missed [units of `spot.SCHEMA`, turned into the body frame at the start of the row]: of
    R recorded rows in their order. home: the hand's place in the base's frame where a run begins [m]. row_s: what a row
    lasts on average [s].
    """

    model: ResidualModel
    ages: Float[Array, " 2"]
    durations: Float[Array, " R"]
    missed: Float[Array, "R 12"]
    home: Float[Array, " 3"]
    row_s: Float[Array, ""]


def true(state: Float[Array, " 12"], ages: Float[Array, " 2"]) -> Float[Array, " 12"]:
    """The state without the sensors' lateness: each position carried on by its velocity."""
    parts = state.reshape(TRIPLES, 3)
    parts = parts.at[0::2].add(ages[:, None] * parts[1::2])
    return wrapped(parts.reshape(-1))


def measured(state: Float[Array, " 12"], ages: Float[Array, " 2"]) -> Float[Array, " 12"]:
    """Inverse of `true`: what the sensors say."""
    return true(state, -ages)


def advance(
    model: ResidualModel, state: Float[Array, " 12"], commands: Float[Array, "3 6"], duration: Float[Array, ""]
) -> Float[Array, " 12"]:
    """The state after a row of so many steps, by the model alone; commands are u_{t-2}, u_{t-1}, u_t."""
    encoded = encode_state(SCHEMA, state)
    change = steady(
        replace(model, pace=duration, carried=jnp.ones(())), jnp.concatenate([encoded, commands.reshape(-1)])
    )
    return decode_state(SCHEMA, encoded + change[0])


def departed(state: Float[Array, " 12"], then: Float[Array, " 12"], missed: Float[Array, " 12"]) -> Float[Array, " 12"]:
    """The state `then` with what the model missed in the row that began in `state`."""
    return wrapped(then + (missed.reshape(TRIPLES, 3) @ rotation(state[2]).T).reshape(-1))


def departure(state: Float[Array, " 12"], then: Float[Array, " 12"], real: Float[Array, " 12"]) -> Float[Array, " 12"]:
    """What was missed where `real` came and not `then`: `departed(state, then, .)` of it is `real`."""
    return (wrapped(real - then).reshape(TRIPLES, 3) @ rotation(state[2])).reshape(-1)


def wrapped(state: Float[Array, " 12"]) -> Float[Array, " 12"]:
    """The yaw in [-pi, pi]."""
    return state.at[2].set(jnp.arctan2(jnp.sin(state[2]), jnp.cos(state[2])))


def at_home(twin: Twin) -> Float[Array, " 12"]:
    """Standing still at the world's origin."""
    return jnp.zeros(len(SCHEMA.state)).at[np.array([6, 7, 8])].set(twin.home)
