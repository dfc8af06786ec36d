"""Predictions over many rows: how long these last, and whether the residual helps, as the sessions at hand show."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.recordings import HISTORY, decode_state, encode_state
from simgap.residual.config import Config
from simgap.residual.model import ResidualModel, steady
from simgap.types import Recording

STARTS = 64
"""Starts of predictions at most."""


def kept(model: ResidualModel, sessions: Sequence[Recording], config: Config) -> ResidualModel:
    """The model with the pace, of `config.paces`, at which its positions are nearest to those of the sessions.

    Predictions over `config.horizon` rows, or as many as the longest session has; with the residual, or without it
    where that is nearer. Distances are averages over bodies and rows.
    """
    rows = min(config.horizon, max(len(r.time_s) for r in sessions) - HISTORY - 1)
    starts = [(r, t) for r in sessions for t in range(HISTORY, len(r.time_s) - rows)]
    starts = starts[:: -(-len(starts) // STARTS)]
    state = jnp.asarray(np.stack([r.state[t : t + rows + 1] for r, t in starts]), jnp.float32)
    commands = jnp.asarray(np.stack([r.command[t - HISTORY : t + rows] for r, t in starts]), jnp.float32)
    ways = [replace(model, pace=jnp.asarray(pace), carried=jnp.asarray(carried))
            for carried in (0.0, 1.0) for pace in config.paces]  # fmt: skip
    distances = [float(_distance(way, state, commands)) for way in ways]
    return ways[int(np.nanargmin(distances))]


@jax.jit
def _distance(model: ResidualModel, state: Float[Array, "n t s"], commands: Float[Array, "n c u"]) -> Float[Array, ""]:
    """Mean distance [m] of predicted positions from measured ones, over rows after the first and starts."""
    schema = model.simulator.schema
    places = np.array([i for i, f in enumerate(schema.state) if f.kind == "position"])

    def one(state: Float[Array, "t s"], commands: Float[Array, "c u"]) -> Float[Array, "t s"]:
        def advance(now: Array, row: Array) -> tuple[Array, Array]:
            encoded = encode_state(schema, now)
            sent = jax.lax.dynamic_slice_in_dim(commands, row, HISTORY + 1)
            change = steady(model, jnp.concatenate([encoded, sent.reshape(-1)])).mean(0)
            then = decode_state(schema, encoded + change)
            return then, then

        return jax.lax.scan(advance, state[0], jnp.arange(len(state) - 1))[1]

    predicted = jax.vmap(one)(state, commands)
    return jnp.linalg.norm((predicted - state[:, 1:])[..., places], axis=-1).mean()
