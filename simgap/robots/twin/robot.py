"""A twin as a robot that policies are run on: state and recorded departures inside."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from simgap.recordings import HISTORY
from simgap.robots.twin.model import Twin, at_home, measured, row
from simgap.simulators.spot import SCHEMA


class TwinRobot:
    """See `simgap.types.Robot`; equal keys and commands make equal runs.

    Every run goes through the recorded rows, with their durations and departures, from one that the key draws.

    limit: the greatest command that it admits [m/s, m/s, rad/s, m/s, m/s, m/s].
    """

    def __init__(self, key: PRNGKeyArray, twin: Twin, limit: tuple[float, ...]) -> None:
        self._twin, self._limit = jax.tree.map(jnp.asarray, twin), np.array(limit)
        self._first = int(jax.random.randint(key, (), 0, len(twin.durations)))
        self.reset()

    @property
    def time_step(self) -> float:
        """See `Robot`; the mean of what rows last."""
        return float(self._twin.row_s)

    def reset(self) -> None:
        """See `Robot`; the same rows follow after every reset."""
        self._row, self._state = self._first, at_home(self._twin)
        self._sent = np.zeros((HISTORY, len(SCHEMA.command)), np.float32)

    def observe(self) -> Float[np.ndarray, " 12"]:
        """See `Robot`."""
        return np.asarray(_measured(self._twin, self._state))

    def command(self, command: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 6"]:
        """See `Robot`."""
        admitted = np.clip(command, -self._limit, self._limit)
        sent = np.concatenate([self._sent, admitted[None]]).astype(np.float32)
        self._state = _after(self._twin, self._state, jnp.asarray(sent), jnp.asarray(self._row))
        self._sent, self._row = sent[1:], (self._row + 1) % len(self._twin.durations)
        return admitted

    def stop(self) -> None:
        """See `Robot`."""
        self.command(np.zeros_like(self._limit))


@jax.jit
def _measured(twin: Twin, state: Float[Array, " 12"]) -> Float[Array, " 12"]:
    return measured(state, twin.ages)


@jax.jit
def _after(
    twin: Twin, state: Float[Array, " 12"], commands: Float[Array, "3 6"], at: Int[Array, ""]
) -> Float[Array, " 12"]:
    return row(twin.model, twin.reach, state, commands, (twin.durations[at], twin.missed[at]))
