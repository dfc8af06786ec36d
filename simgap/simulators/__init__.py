"""Hand-made models of robots. To bring one's own, write a module like `spot` with an object that is a `Simulator`."""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from simgap.recordings import HISTORY, Normalisation, decode_state, encode_state
from simgap.types import Remembering, Simulator


def parameter_ranges(simulator: Simulator) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Lower and upper ends of the plausible ranges."""
    return (
        np.array([p.low for p in simulator.parameters], np.float32),
        np.array([p.high for p in simulator.parameters], np.float32),
    )


def sample_parameters(simulator: Simulator, key: PRNGKeyArray, count: int) -> Float[Array, "count p"]:
    """phi ~ p(phi): uniform in the plausible ranges [Hoffman et al. 2025, Sim-FSVGD]."""
    low, high = parameter_ranges(simulator)
    return jax.random.uniform(key, (count, len(low)), minval=low, maxval=high)


def state_difference(simulator: Simulator, params: Float[Array, " p"], x: Float[Array, " x"]) -> Float[Array, " y"]:
    """g(x, phi): the simulator on the learning problem's input and output.

    x = [encoded s_t, u_{t-2}, u_{t-1}, u_t], y = encoded s_{t+1} - encoded s_t. The paper's equations take u_t alone; a
    simulator with effects on the command path, such as a dead time, takes all three (`step_from_history`).
    """
    encoded, command = x[: len(simulator.schema.encoded)], x[-len(simulator.schema.command) :]
    state = decode_state(simulator.schema, encoded)
    if isinstance(simulator, Remembering):
        commands = x[len(encoded) :].reshape(HISTORY + 1, len(command))
        state_next = simulator.step_from_history(params, state, commands)
    else:
        state_next = simulator.step(params, state, command)
    return encode_state(simulator.schema, state_next) - encoded


def normalised_functions(
    simulator: Simulator, phi: Float[Array, "P p"], stats: Normalisation
) -> Callable[[Float[Array, "k x"]], Float[Array, "P k y"]]:
    """The domain-model process: P simulators as functions from normalised inputs to normalised outputs."""

    def functions(x: Float[Array, "k x"]) -> Float[Array, "P k y"]:
        at_all_points = jax.vmap(lambda p, x: state_difference(simulator, p, x), in_axes=(None, 0))
        h = jax.vmap(at_all_points, in_axes=(0, None))(phi, x * stats.x_std + stats.x_mean)
        return (h - stats.y_mean) / stats.y_std

    return functions
