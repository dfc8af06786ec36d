"""What a twin is, and how it moves by one row.

Its state is what the sensors would say if they were not late: a measured position is older than its velocity by the
body's `ages`. A row lasts `duration` steps of the simulator, and a recorded departure from the model, `missed`, is
added; the hand does not go beyond the arm's reach. A twin that replays a session's commands, durations and departures
repeats the session, but for rows at the end of the reach.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.recordings import decode_state, encode_state
from simgap.residual.model import ResidualModel, steady
from simgap.robots.virtual_spot import VirtualSpotConfig
from simgap.simulators.spot import SCHEMA, from_body, induced_velocity, rotation, to_body

SHOULDER = VirtualSpotConfig().shoulder
"""In the base's frame, z above the floor [m]."""
TRIPLES = len(SCHEMA.state) // 3
"""Pose and velocity of the base, position and velocity of the hand: three states each."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=("model", "ages", "reach", "durations", "missed", "home", "row_s"),
    meta_fields=(),
)
@dataclass(frozen=True)
class Twin:
    """A fitted model with what was recorded beyond it.

    model: the simulator with its fitted parameters and a residual of one particle. ages: by how much a measured
    position is older than its velocity, of base and hand [s], given how the simulator integrates velocities. reach:
    greatest recorded distance of the hand from the shoulder [m]. durations [steps of the simulator] and missed [units
    of `spot.SCHEMA`, turned into the body frame at the start of the row]: of R recorded rows in their order. home: the
    hand's place in the base's frame where a run begins [m]. row_s: what a row lasts on average [s].
    """

    model: ResidualModel
    ages: Float[Array, " 2"]
    reach: Float[Array, ""]
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
    model: ResidualModel,
    reach: Float[Array, ""],
    state: Float[Array, " 12"],
    commands: Float[Array, "3 6"],
    duration: Float[Array, ""],
) -> Float[Array, " 12"]:
    """The state after a row that lasts `duration` [steps], without a departure; commands are u_{t-2}, u_{t-1}, u_t."""
    model, encoded = replace(model, pace=duration, carried=jnp.ones(())), encode_state(SCHEMA, state)
    change = steady(model, jnp.concatenate([encoded, commands.reshape(-1)]))
    return within(decode_state(SCHEMA, encoded + change[0]), reach)


def within(state: Float[Array, " 12"], reach: Float[Array, ""]) -> Float[Array, " 12"]:
    """The state with the hand no farther than `reach` [m] from the shoulder, and there not on its way outwards."""
    body = to_body(state)
    base, hand, velocity = body[3:6], body[6:9], body[9:]
    carried = base.at[2].set(0.0) + induced_velocity(base[2], hand)
    arm = hand - jnp.array(SHOULDER)
    distance = jnp.linalg.norm(arm)
    outward = jnp.maximum((velocity - carried) @ arm / distance, 0.0)
    held = body.at[6:9].set(jnp.array(SHOULDER) + reach * arm / distance)
    held = held.at[9:].add(-outward * arm / distance)
    return jnp.where(distance > reach, from_body(held), state)


def departed(state: Float[Array, " 12"], then: Float[Array, " 12"], missed: Float[Array, " 12"]) -> Float[Array, " 12"]:
    """The state `then` with what the model missed in the row that began in `state`."""
    return wrapped(then + (missed.reshape(TRIPLES, 3) @ rotation(state[2]).T).reshape(-1))


def row(
    model: ResidualModel,
    reach: Float[Array, ""],
    state: Float[Array, " 12"],
    commands: Float[Array, "3 6"],
    recorded: tuple[Float[Array, ""], Float[Array, " 12"]],
) -> Float[Array, " 12"]:
    """The state after a row with the duration and the departure of a recorded one."""
    duration, missed = recorded
    then = advance(model, reach, state, commands, duration)
    return within(departed(state, then, missed), reach)


def departure(state: Float[Array, " 12"], then: Float[Array, " 12"], real: Float[Array, " 12"]) -> Float[Array, " 12"]:
    """What was missed where `real` came and not `then`: `departed(state, then, .)` of it is `real`."""
    return (wrapped(real - then).reshape(TRIPLES, 3) @ rotation(state[2])).reshape(-1)


def wrapped(state: Float[Array, " 12"]) -> Float[Array, " 12"]:
    """The yaw in [-pi, pi]."""
    return state.at[2].set(jnp.arctan2(jnp.sin(state[2]), jnp.cos(state[2])))


def at_home(twin: Twin) -> Float[Array, " 12"]:
    """Standing still at the world's origin."""
    return jnp.zeros(len(SCHEMA.state)).at[np.array([6, 7, 8])].set(twin.home)
