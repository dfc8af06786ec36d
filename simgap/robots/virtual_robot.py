"""The virtual Spot as a robot that policies are run on: state and clock inside, as of a real one."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from simgap.robots import virtual_spot
from simgap.robots.virtual_spot import VirtualSpotConfig, VirtualSpotState


class VirtualRobot:
    """See `simgap.types.Robot`; equal keys and commands make equal runs.

    limit: the greatest command that it admits [m/s, m/s, rad/s, m/s, m/s, m/s].
    """

    def __init__(self, key: PRNGKeyArray, config: VirtualSpotConfig, limit: tuple[float, ...]) -> None:
        self._start, self._config, self._limit = key, config, np.array(limit)
        self.reset()

    @property
    def time_step(self) -> float:
        """See `Robot`."""
        return self._config.time_step

    def reset(self) -> None:
        """See `Robot`; the same noise follows after every reset."""
        self._key, self._state = self._start, virtual_spot.init(self._config)

    def observe(self) -> Float[np.ndarray, " 12"]:
        """See `Robot`."""
        return np.asarray(_measure(self._state, jax.random.fold_in(self._key, 0), self._config))

    def command(self, command: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 6"]:
        """See `Robot`."""
        admitted = np.clip(command, -self._limit, self._limit)
        self._state = _step(self._state, jnp.asarray(admitted), jax.random.fold_in(self._key, 1), self._config)
        self._key = jax.random.fold_in(self._key, 2)
        return admitted

    def stop(self) -> None:
        """See `Robot`."""
        self.command(np.zeros_like(self._limit))


@partial(jax.jit, static_argnames="config")
def _measure(state: VirtualSpotState, key: PRNGKeyArray, config: VirtualSpotConfig) -> Float[Array, " 12"]:
    return virtual_spot.measure(state, key, config)


@partial(jax.jit, static_argnames="config")
def _step(
    state: VirtualSpotState, command: Float[Array, " 6"], key: PRNGKeyArray, config: VirtualSpotConfig
) -> VirtualSpotState:
    return virtual_spot.step(state, command, key, config)
