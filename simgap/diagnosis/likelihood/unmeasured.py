"""Unmeasured states: their first guess, and their estimates by a fitted model.

The slope of a position is the first guess of its velocity. The first guess of other states is where the simulator as it
is leads them from zero, given what is measured. These guesses only initialise the filter. The start of each segment is
fitted together with a model (`inference.starts`), and the filter's estimates replace the guesses.
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.diagnosis.likelihood.filter import filtered
from simgap.diagnosis.likelihood.problem import Problem, estimates
from simgap.diagnosis.likelihood.segments import RUN_IN, Chunks, bare
from simgap.diagnosis.likelihood.variables import Variables
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales
from simgap.effects.stepping import Given, next_state
from simgap.engines import Engine, is_engine
from simgap.layout import Layout
from simgap.types import Recording, Sessions, StepModel

SLOPE_ROWS = 2
"""Rows before and after each row over which the slope of a position is taken."""


def guessed(simulator: StepModel | Engine, sessions: Sessions) -> Sessions:
    """Sessions with a first guess of their unmeasured states, in columns after the measured ones."""
    augmented = Augmented(simulator)
    if augmented.layout.observed.all():
        return sessions
    return sessions.each(lambda r: _guessed(augmented, r))


def _guessed(augmented: Augmented, recording: Recording) -> Recording:
    layout = augmented.layout
    count = int(layout.observed.sum())
    state = np.zeros((len(recording.state), len(layout.observed)))
    state[:, :count] = recording.state
    for position, velocity in sloped(layout):
        state[:, velocity] = _slopes(recording.time_s, state[:, position])
    if layout.apart.any() and not is_engine(augmented.simulator):
        led = np.asarray(_led(augmented, jnp.asarray(state, jnp.float32), jnp.asarray(recording.command, jnp.float32)))
        state[:, layout.apart] = np.where(np.isfinite(led), led, 0.0)[:, layout.apart]
    return recording._replace(state=state)


def sloped(layout: Layout) -> list[tuple[int, int]]:
    """Measured positions whose slopes are the guess of unmeasured velocities, and these."""
    count = int(layout.observed.sum())
    pairs = zip(layout.position.flat, layout.velocity.flat, strict=True)
    return [(int(p), int(v)) for p, v in pairs if v >= count > p >= 0]


@partial(jax.jit, static_argnames="augmented")
def _led(augmented: Augmented, state: Float[Array, "T s"], command: Float[Array, "T u"]) -> Float[Array, "T s"]:
    """States of which those `apart` follow the simulator as it is, and the others are as given."""
    apart = jnp.asarray(augmented.layout.apart)

    def row(x: Float[Array, " s"], now: tuple) -> tuple[Float[Array, " s"], Float[Array, " s"]]:
        given, u = now
        x = jnp.where(apart, x, given)
        return next_state(augmented, x, Given(jnp.asarray(augmented.nominal), u, None, None)), x

    return jax.lax.scan(row, jnp.zeros_like(state[0]), (state, command))[1]


def _slopes(time_s: Float[np.ndarray, " T"], values: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Least-squares slope over the rows around each row."""
    rows = np.clip(np.arange(len(values))[:, None] + np.arange(-SLOPE_ROWS, SLOPE_ROWS + 1), 0, len(values) - 1)
    t, y = time_s[rows], values[rows]
    t = t - t.mean(1, keepdims=True)
    return (t * y).sum(1) / np.maximum((t * t).sum(1), 1e-12)


def estimated(problem: Problem, v: Variables, recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings with a fitted model's estimates of their unmeasured states."""
    hidden, chunks = ~problem.augmented.layout.observed, problem.chunks
    x = estimates(problem, v)
    x = np.where(np.isfinite(x), x, np.asarray(chunks.state)[:, :-1])
    states = [np.array(r.state) for r in recordings]
    for chunk in _recorded(chunks):
        first, state = chunks.row[chunk], states[chunks.session[chunk]]
        settled = RUN_IN if first else 0  # the run-in keeps the estimates of the segment before
        rows = np.arange(first + settled, min(first + x.shape[1], len(state)))
        state[np.ix_(rows, hidden)] = x[chunk, rows - first][:, hidden]
    return [r._replace(state=state) for r, state in zip(recordings, states, strict=True)]


def _recorded(chunks: Chunks) -> list[int]:
    """Segments with scored rows; the others only pad their number."""
    return np.flatnonzero(np.asarray(chunks.counts).any(1)).tolist()


def chained(problem: Problem, v: Variables) -> Chunks:
    """Segments whose unmeasured states begin with the estimates of the segment before, where there is one."""
    hidden, chunks = ~problem.augmented.layout.observed, problem.chunks
    x, state, last = estimates(problem, v), np.array(chunks.state), None
    for chunk in _recorded(chunks):
        rows = chunks.row[chunk] - chunks.row[last] if last is not None else 0
        if last is not None and chunks.session[chunk] == chunks.session[last] and rows < x.shape[1]:
            found = x[last, rows, hidden]
            state[chunk, 0, hidden] = np.where(np.isfinite(found), found, state[chunk, 0, hidden])
        last = chunk
    return chunks._replace(state=jnp.asarray(state))


@partial(jax.jit, static_argnames="augmented")
def by_start(augmented: Augmented, scales: Scales, v: Variables, chunks: Chunks) -> Float[Array, "C k T-1 o"]:
    """Derivatives of the innovations, of all rows, by the k unmeasured states in their segment's first row."""
    hidden = np.flatnonzero(~augmented.layout.observed)

    def one(chunk: Chunks) -> Float[Array, "k T-1 o"]:
        def e(start: Float[Array, " k"]) -> Float[Array, "T-1 o"]:
            state = chunk.state.at[0, hidden].set(start)
            nested = jax.tree.map(lambda a: a[None], chunk._replace(state=state))
            return filtered(augmented, scales, v, nested, v.phi).innovations[0]

        return jnp.moveaxis(jax.jacfwd(e)(chunk.state[0, hidden]), -1, 0)

    return jax.vmap(one)(bare(chunks))
