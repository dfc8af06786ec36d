"""Rows that last longer or shorter than the nominal step: the simulator after any number of steps, and their law.

A recording that stalls holds rows of several steps, all of whose outputs change by more; which rows, nobody can say
beforehand. So a row's duration is drawn from a law, given by Q equally likely durations.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.recordings import HISTORY
from simgap.simulators import state_difference
from simgap.types import Simulator

STEPS = 4
"""Steps that a simulator is run for; longer rows go on as the last step did."""


def path(simulator: Simulator, params: Float[Array, " p"], x: Float[Array, " x"]) -> Float[Array, "k y"]:
    """The change of the encoded state after 0, 1, ... `STEPS` steps, the last command held."""
    encoded = len(simulator.schema.encoded)

    def step(now: Float[Array, " x"], _: None) -> tuple[Float[Array, " x"], Float[Array, " y"]]:
        state = now[:encoded] + state_difference(simulator, params, now)
        commands = now[encoded:].reshape(HISTORY + 1, -1)
        return jnp.concatenate([state, commands[1:].reshape(-1), commands[-1]]), state - x[:encoded]

    _, passed = jax.lax.scan(step, x, length=STEPS)
    return jnp.concatenate([jnp.zeros((1, encoded)), passed])


def after(path: Float[Array, "k y"], durations: Float[Array, " q"]) -> Float[Array, "q y"]:
    """The change after each of these durations [steps], between steps and beyond the last on a straight line."""
    last = jnp.clip(jnp.floor(durations).astype(int), 0, len(path) - 2)
    share = (durations - last)[:, None]
    return (1 - share) * path[last] + share * path[last + 1]
