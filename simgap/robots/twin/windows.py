"""Windows of sessions, and what a model predicts of them from their first state, commands and durations alone."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.recordings import HISTORY
from simgap.residual.model import ResidualModel
from simgap.robots.twin.model import measured, row, true, wrapped
from simgap.robots.twin.rows import Rows


class Windows(NamedTuple):
    """n windows of h rows: measured states, the commands from `HISTORY` rows before on, durations [steps]."""

    state: Float[Array, "n h+1 12"]
    command: Float[Array, "n h+2 6"]
    duration: Float[Array, "n h"]


def cut(sessions: Sequence[Rows], horizon: int, stride: int) -> Windows:
    """Every `stride`-th window of the sessions that are long enough; at least one must be."""
    found = [
        (s.state[t : t + horizon + 1], s.command[t - HISTORY : t + horizon], s.duration[t : t + horizon])
        for s in sessions
        for t in range(HISTORY, len(s.state) - horizon, stride)
    ]
    return Windows(*(jnp.asarray(np.stack(part), jnp.float32) for part in zip(*found, strict=True)))


def padded(windows: Windows) -> Windows:
    """Windows up to the next power of two, by repeating the last: numbers that are close run the same program."""
    count = len(windows.duration)
    some = np.minimum(np.arange(1 << (count - 1).bit_length()), count - 1)
    return jax.tree.map(lambda a: a[some], windows)


def predict(
    model: ResidualModel,
    ages: Float[Array, " 2"],
    reach: Float[Array, ""],
    windows: Windows,
    missed: Float[Array, "n h 12"] | None = None,
) -> Float[Array, "n h 12"]:
    """The states after each row of every window, as measured; with what was missed in each row, where it is given."""
    missed = jnp.zeros((*windows.duration.shape, windows.state.shape[-1])) if missed is None else missed

    def one(window: Windows, missed: Float[Array, "h 12"]) -> Float[Array, "h 12"]:
        def after(now: Array, t: Array) -> tuple[Array, Array]:
            sent = jax.lax.dynamic_slice_in_dim(window.command, t, HISTORY + 1)
            then = row(model, reach, now, sent, (window.duration[t], missed[t]))
            return then, measured(then, ages)

        start = true(window.state[0], ages)
        return jax.lax.scan(after, start, jnp.arange(len(window.duration)))[1]

    return jax.vmap(one)(windows, missed)


def errors(predicted: Float[Array, "n h 12"], windows: Windows) -> Float[Array, "n h 12"]:
    """Predicted less measured."""
    return jax.vmap(jax.vmap(wrapped))(predicted - windows.state[:, 1:])
