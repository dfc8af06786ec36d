"""Unmeasured states: their first guess, and their estimates by a fitted model.

The slope of a position is the first guess of its velocity. The first guess of other states is where the simulator as it
is leads them from zero, given what is measured. These guesses only initialise the filter. Once a model is fitted, each
segment's start is fitted too, and the filter's estimates replace the guesses.
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
from simgap.diagnosis.likelihood.student_t import NORMAL_MAD
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales
from simgap.effects.stepping import Given, next_state
from simgap.engines import Engine, is_engine
from simgap.types import Recording, Sessions, StepModel

SLOPE_ROWS = 2
"""Rows before and after each row over which the slope of a position is taken."""


def guessed(simulator: StepModel | Engine, sessions: Sessions) -> Sessions:
    """Sessions with a first guess of their unmeasured states, in columns after the measured ones."""
    augmented = Augmented(simulator)
    if augmented.layout.observed.all():
        return sessions
    return Sessions(*([_guessed(augmented, r) for r in recordings] for recordings in sessions))


def _guessed(augmented: Augmented, recording: Recording) -> Recording:
    layout = augmented.layout
    count = int(layout.observed.sum())
    state = np.zeros((len(recording.state), len(layout.observed)))
    state[:, :count] = recording.state
    for position, velocity in zip(layout.position.flat, layout.velocity.flat, strict=True):
        if velocity >= count > position >= 0:
            state[:, velocity] = _slopes(recording.time_s, state[:, position])
    if layout.apart.any() and not is_engine(augmented.simulator):
        led = np.asarray(_led(augmented, jnp.asarray(state, jnp.float32), jnp.asarray(recording.command, jnp.float32)))
        state[:, layout.apart] = np.where(np.isfinite(led), led, 0.0)[:, layout.apart]
    return recording._replace(state=state)


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


def estimated(problem: Problem, v: Variables, chunks: Chunks, recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings with a fitted model's estimates of their unmeasured states."""
    hidden = ~problem.augmented.layout.observed
    chunks = chunks._replace(state=fitted_starts(problem, v, chunks))
    x = estimates(problem._replace(chunks=chunks), v)
    x = np.where(np.isfinite(x), x, np.asarray(chunks.state)[:, :-1])
    states = [np.array(r.state) for r in recordings]
    for chunk, (session, first) in enumerate(zip(chunks.session, chunks.row, strict=True)):
        state = states[session]
        settled = RUN_IN if first else 0  # the run-in keeps the estimates of the segment before
        rows = np.arange(first + settled, min(first + x.shape[1], len(state)))
        state[np.ix_(rows, hidden)] = x[chunk, rows - first][:, hidden]
        state[first, hidden] = x[chunk, 0, hidden]
    return [r._replace(state=state) for r, state in zip(recordings, states, strict=True)]


def fitted_starts(problem: Problem, v: Variables, chunks: Chunks) -> Float[np.ndarray, "C T s"]:
    """States of the segments; the unmeasured ones of the first row are fitted by one weighted least-squares step.

    Their usual size is the prior's standard deviation: a start that nothing measured depends on stays where it is.
    """
    _, raw = filtered(problem.augmented, problem.scales, v, chunks)
    size = NORMAL_MAD * np.median(np.abs(np.asarray(raw)), axis=(0, 1))
    moved = _steps(problem.augmented, problem.scales, v, chunks, jnp.asarray(1 / np.maximum(size, 1e-12)))
    state = np.array(chunks.state)
    state[:, 0, ~problem.augmented.layout.observed] += np.where(np.isfinite(moved), moved, 0.0)
    return state


@partial(jax.jit, static_argnames="augmented")
def _steps(
    augmented: Augmented, scales: Scales, v: Variables, chunks: Chunks, weight: Float[Array, " o"]
) -> Float[Array, "C k"]:
    """Least-squares steps of the unmeasured states in each segment's first row, which reduce its innovations."""
    hidden = np.flatnonzero(~augmented.layout.observed)
    prior = jnp.diag(1 / scales.output[hidden])

    def one(chunk: Chunks) -> Float[Array, " k"]:
        def e(start: Float[Array, " k"]) -> Float[Array, " n"]:
            state = chunk.state.at[0, hidden].set(start)
            nested = jax.tree.map(lambda a: a[None], chunk._replace(state=state))
            return (filtered(augmented, scales, v, nested)[1][0] * weight).ravel()

        start = chunk.state[0, hidden]
        J, residuals = jnp.concatenate([jax.jacfwd(e)(start), prior]), jnp.pad(e(start), (0, len(hidden)))
        return -jnp.linalg.lstsq(J, residuals)[0]

    return jax.vmap(one)(bare(chunks))
