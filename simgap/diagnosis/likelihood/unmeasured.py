"""States that recordings lack: where a filter begins with them, and what it makes of them.

They are never measured: a slope of positions is where the first filter begins, and nothing else is made of it. Once a
model is fitted, each segment's start is fitted too, and the filter's estimates take the slope's place.
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.diagnosis.likelihood.filter import Variables, filtered
from simgap.diagnosis.likelihood.problem import Problem, estimates
from simgap.diagnosis.likelihood.segments import RUN_IN, Chunks, bare
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales
from simgap.layout import Layout
from simgap.types import Recording, Sessions

SLOPE_ROWS = 2
"""Rows before and after one over which the slope of a position is a first guess of its velocity."""


def guessed(layout: Layout, sessions: Sessions) -> Sessions:
    """Sessions with a first guess of the states that they lack, in columns behind the measured ones."""
    if layout.observed.all():
        return sessions
    return Sessions(*([_guessed(layout, r) for r in some] for some in sessions))


def _guessed(layout: Layout, recording: Recording) -> Recording:
    count = int(layout.observed.sum())
    state = np.zeros((len(recording.state), len(layout.observed)))
    state[:, :count] = recording.state
    for position, velocity in zip(layout.position.flat, layout.velocity.flat, strict=True):
        if velocity >= count > position >= 0:
            state[:, velocity] = _slopes(recording.time_s, state[:, position])
    return recording._replace(state=state)


def _slopes(time_s: Float[np.ndarray, " T"], values: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Slope of the line through the rows around each one, by least squares."""
    rows = np.clip(np.arange(len(values))[:, None] + np.arange(-SLOPE_ROWS, SLOPE_ROWS + 1), 0, len(values) - 1)
    t, y = time_s[rows], values[rows]
    t = t - t.mean(1, keepdims=True)
    return (t * y).sum(1) / np.maximum((t * t).sum(1), 1e-12)


def estimated(problem: Problem, v: Variables, chunks: Chunks, recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings with what a fitted model makes of the states that they lack."""
    hidden = ~problem.augmented.layout.observed
    chunks = chunks._replace(state=fitted_starts(problem, v, chunks))
    x = estimates(problem._replace(chunks=chunks), v)
    x = np.where(np.isfinite(x), x, np.asarray(chunks.state)[:, :-1])
    states = [np.array(r.state) for r in recordings]
    for chunk, (session, first) in enumerate(zip(chunks.session, chunks.row, strict=True)):
        state = states[session]
        settled = RUN_IN if first else 0  # where an earlier segment has its say
        rows = np.arange(first + settled, min(first + x.shape[1], len(state)))
        state[np.ix_(rows, hidden)] = x[chunk, rows - first][:, hidden]
        state[first, hidden] = x[chunk, 0, hidden]
    return [r._replace(state=state) for r, state in zip(recordings, states, strict=True)]


def fitted_starts(problem: Problem, v: Variables, chunks: Chunks) -> Float[np.ndarray, "C T s"]:
    """States of the segments, the first row's unmeasured ones by one step of weighted least squares."""
    _, raw = filtered(problem.augmented, problem.scales, v, chunks)
    size = 1.4826 * np.median(np.abs(np.asarray(raw)), axis=(0, 1))
    moved = _steps(problem.augmented, problem.scales, v, chunks, jnp.asarray(1 / np.maximum(size, 1e-12)))
    state = np.array(chunks.state)
    state[:, 0, ~problem.augmented.layout.observed] += np.where(np.isfinite(moved), moved, 0.0)
    return state


@partial(jax.jit, static_argnames="augmented")
def _steps(
    augmented: Augmented, scales: Scales, v: Variables, chunks: Chunks, weight: Float[Array, " o"]
) -> Float[Array, "C k"]:
    """To where the innovations of each segment are least, along the unmeasured states of its first row."""
    hidden = np.flatnonzero(~augmented.layout.observed)

    def one(chunk: Chunks) -> Float[Array, " k"]:
        def e(start: Float[Array, " k"]) -> Float[Array, " n"]:
            state = chunk.state.at[0, hidden].set(start)
            nested = jax.tree.map(lambda a: a[None], chunk._replace(state=state))
            return (filtered(augmented, scales, v, nested)[1][0] * weight).ravel()

        start = chunk.state[0, hidden]
        J, missed = jax.jacfwd(e)(start), e(start)
        return -jnp.linalg.lstsq(J, missed, rcond=1e-4)[0]

    return jax.vmap(one)(bare(chunks))
