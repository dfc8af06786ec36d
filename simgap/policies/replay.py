"""Replay memory: a ring of transitions, each one row, so that a batch is one gather."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int


class Experience(NamedTuple):
    """Transitions of an environment: in an observation, an action was taken; `discount` is 0 where nothing follows."""

    observation: Float[Array, "... o"]
    action: Float[Array, "... a"]
    reward: Float[Array, "..."]
    discount: Float[Array, "..."]
    following: Float[Array, "... o"]


class Replay(NamedTuple):
    """`rows[i]` is a packed `Experience`; the oldest is overwritten once `added` exceeds their number."""

    rows: Float[Array, "capacity d"]
    added: Int[Array, ""]


def init(capacity: int, observation_size: int, action_size: int) -> Replay:
    """An empty memory."""
    return Replay(jnp.zeros((capacity, 2 * observation_size + action_size + 2)), jnp.zeros((), jnp.int32))


def add(replay: Replay, new: Experience) -> Replay:
    """The memory with n more transitions, n at most its capacity."""
    rows = jnp.concatenate(
        [new.observation, new.action, new.reward[:, None], new.discount[:, None], new.following], axis=1
    )
    places = (replay.added + jnp.arange(len(rows))) % len(replay.rows)
    return Replay(replay.rows.at[places].set(rows), replay.added + len(rows))


def sample(replay: Replay, uniform: Float[Array, " n"], action_size: int) -> Experience:
    """n transitions of those there are, with repetition; drawn uniformly where `uniform` is, in [0, 1)."""
    filled = jnp.minimum(replay.added, len(replay.rows))
    # Far cheaper than drawing integers, and as uniform as single precision is at 50,000.
    rows = replay.rows[jnp.int32(uniform * filled)]
    o = (rows.shape[1] - action_size - 2) // 2
    edges = (o, o + action_size, o + action_size + 1, o + action_size + 2)
    observation, action, reward, discount, following = jnp.split(rows, edges, axis=1)
    return Experience(observation, action, reward[:, 0], discount[:, 0], following)
