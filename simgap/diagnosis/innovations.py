"""Innovations: what a measured row adds to what the rows before it foretold [Ljung 1999, prediction-error methods].

The state is measured with noise, so a regression on measured states is biased where nothing is missing. Here the
estimate x of the state is carried by the simulator and corrected by each measurement y only as far as it deserves:

    e_t = y_t - h(f(x_{t-1}, u_{t-1}))        x_t = f(x_{t-1}, u_{t-1}) + K e_t

with a gain K, fitted together with everything else. It reaches across outputs, as Kalman's does: what jolts the base
moves the hand with it, and a position tells of the velocity that led to it. With a gain per output alone innovations
can be foretold where nothing is missing. It is constant in the bodies' own frames. Sessions are cut into chunks that
run side by side, each after a few rows of run-in that do not count.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from simgap.effects.augmented import Active, Augmented, Theta, advance, remember, sense, unsense
from simgap.effects.effect import HISTORY_ROWS, Memory, Row, Scales
from simgap.layout import Layout, rotated, wrapped
from simgap.types import Recording

LENGTH = 40
"""Rows of a chunk that count."""
RUN_IN = 10
"""Rows before them, in which the estimate forgets its start."""
WARM = 30
"""Rows of past commands that run through the command path before a chunk, so that lags are where they were."""
TURNS = 12
"""Turning points of each command before those rows, so that play is where it was; a real Spot has no more."""
PAD = 16
"""The number of chunks is a multiple of this, so that recording sets of like size share what is compiled."""


class Chunks(NamedTuple):
    """Sessions cut into C chunks of T = RUN_IN + LENGTH + 1 rows.

    past, turns: see `sent_before`. counts: whether the row t + 1 of the chunk is scored. gate: where gated constants
    act, 0 or 1. session: index into the recordings; row: of the chunk's first row in its session.
    """

    state: Float[Array, "C T s"]
    command: Float[Array, "C T u"]
    past: Float[Array, "C h u"]
    turns: Float[Array, "C m u"]
    time_s: Float[Array, "C T"]
    interval: Float[Array, "C T"]
    counts: Bool[Array, "C T-1"]
    gate: Float[Array, "C T"]
    session: Int[np.ndarray, " C"]
    row: Int[np.ndarray, " C"]


class Variables(NamedTuple):
    """All that can be fitted: simulator parameters phi, the gain K's diagonal, its entries beside that
    (`Layout.akin`), effects' constants, those where gated."""

    phi: Float[np.ndarray, " p"]
    gain: Float[np.ndarray, " s"]
    cross: Float[np.ndarray, " c"]
    theta: Float[np.ndarray, " P"]
    gated: Float[np.ndarray, " P"]


def sent_before(
    command: Float[np.ndarray, "T u"], row: int
) -> tuple[Float[np.ndarray, "h u"], Float[np.ndarray, "m u"]]:
    """What was sent before a row of a session: the last HISTORY_ROWS + WARM commands, the latest first; and where each
    command turned before the last WARM of them. Before the session, its first command was sent all along."""
    past = command[np.maximum(row - 1 - np.arange(HISTORY_ROWS + WARM), 0)]
    return past, np.reshape([_turns(u) for u in command[: max(row - WARM, 1)].T], (-1, TURNS)).T


def _turns(u: Float[np.ndarray, " T"]) -> Float[np.ndarray, " m"]:
    """The last value, and the highs and lows before it that no later one exceeds, the latest first.

    They alone decide where play stands, whatever its gap and however long the command has rested since: a swing pushes
    it, and a wider one undoes what narrower ones before it did. Where there are too many the widest are left out. The
    oldest is zero: before its session a robot stood still, with the play in the middle of its gap.
    """
    back = u[::-1]
    side = np.sign(np.diff(np.maximum.accumulate(back))) + np.sign(np.diff(np.minimum.accumulate(back)))
    (exceeding,) = side.nonzero()  # one row further back a new high (1) or low (-1) is reached
    widest = exceeding[np.diff(side[exceeding], append=0) != 0] + 1
    found = np.concatenate([back[:1], back[widest]])[: TURNS - 1]
    return np.concatenate([found, np.zeros(TURNS - len(found))])


def cut(recordings: Sequence[Recording], time_step: float, least: int = 0) -> Chunks:
    """Chunks of all sessions; the last of a session is shorter and filled up with rows that do not count.

    There are at least `least`: sets of the same number of chunks share what is compiled.
    """
    rows = RUN_IN + LENGTH + 1
    parts: list[tuple] = []
    for s, r in enumerate(recordings):
        steps = len(r.time_s) - 1
        interval = np.append(np.diff(r.time_s) / time_step, 1.0)
        for first in range(0, max(steps, 1), LENGTH):
            start = max(first - RUN_IN, 0)
            index = np.minimum(np.arange(start, start + rows), steps)
            successor = np.arange(start + 1, start + rows)
            # At a session's start a few rows are let in: the estimate begins at a measured state.
            counted = (successor > max(first, 2)) & (successor <= min(first + LENGTH, steps))
            parts.append((r.state[index], r.command[index], *sent_before(r.command, start),
                          r.time_s[index] - r.time_s[0], interval[index], counted, np.ones(rows), s,
                          start))  # fmt: skip
    while len(parts) % PAD or len(parts) < least:
        *arrays, counted, gate, s, start = parts[0]
        parts.append((*arrays, np.zeros_like(counted), gate, s, start))
    return as_chunks(parts)


def as_chunks(parts: Sequence[tuple]) -> Chunks:
    """Chunks from their fields, one tuple a chunk."""
    *arrays, session, row = (np.stack(a) for a in zip(*parts, strict=True))
    as_float = [jnp.asarray(a if a.dtype == bool else np.asarray(a, np.float32)) for a in arrays]
    return Chunks(*as_float, session=session, row=row)


def bare(chunks: Chunks) -> Chunks:
    """Chunks without where they come from, which is no array of JAX's, for `vmap` over chunks."""
    nothing = jnp.zeros(len(chunks.state))
    return chunks._replace(session=nothing, row=nothing)


def wrap(augmented: Augmented, difference: Float[Array | np.ndarray, "... s"]) -> Float[Array, "... s"]:
    """Differences of states, those of angles between -pi and pi."""
    return wrapped(augmented.layout, jnp.asarray(difference))


def gain_matrix(augmented: Augmented, v: Variables) -> Float[Array, "s s"]:
    """K, in the bodies' own frames. Entries beside its diagonal are fitted in units of the time step, so that all are
    of order one: what a millimetre tells of a velocity is a millimetre in a time step."""
    layout = augmented.layout
    rate = np.array([f.kind == "velocity" for f in layout.schema.state], float)
    i, j = np.array(layout.akin, int).reshape(-1, 2).T
    unit = augmented.simulator.time_step ** (rate[j] - rate[i])
    return jnp.diag(v.gain).at[i, j].set(v.cross * unit)


def corrected(
    layout: Layout, K: Float[Array, "s s"], x: Float[Array, " s"], e: Float[Array, " s"]
) -> Float[Array, " s"]:
    """x + K e, with K in the bodies' own frames."""
    return x + rotated(layout, K @ rotated(layout, e, x, -1.0), x, 1.0)


_Rows = Float[Array, "T-1 s"]


def _chunk(
    augmented: Augmented, scales: Scales, v: Variables, active: Active, chunk: Chunks, other: Theta | None = None
) -> tuple[_Rows, _Rows]:
    """Of one chunk (without its leading axis C), the estimates that its steps begin with, and its innovations.

    With `other` constants, each innovation is what it would be, had that step alone been taken with these.
    """
    K, phi = gain_matrix(augmented, v), jnp.asarray(v.phi)
    at_start = v.theta + chunk.gate[0] * v.gated
    first = unsense(augmented, at_start, chunk.state[0], chunk.time_s[0])
    memory = remember(augmented, phi, at_start, first, chunk.past, chunk.time_s[0], chunk.turns, active)

    def row(carry, now):
        memory, x = carry
        y_next, u, time_s, next_s, interval, gate = now

        def step(theta: Theta) -> tuple[Memory, Float[Array, " s"], Float[Array, " s"]]:
            here, theta = Row(time_s, interval), theta + gate * v.gated
            after, foretold = advance(augmented, phi, theta, scales, memory, x, u, here, active)
            seen = sense(augmented, theta, after, foretold, here._replace(time_s=next_s), active)
            return after, foretold, wrap(augmented, y_next - seen)

        after, foretold, e = step(v.theta)
        told = e if other is None else step(other)[2]
        return (after, corrected(augmented.layout, K, foretold, e)), (x, told)

    times = (chunk.time_s[:-1], chunk.time_s[1:])
    rows = (chunk.state[1:], chunk.command[:-1], *times, chunk.interval[:-1], chunk.gate[:-1])
    return jax.lax.scan(row, (memory, first), rows)[1]


def _all(augmented: Augmented, scales: Scales, v: Variables, active: Active, chunks: Chunks) -> Float[Array, "C T-1 s"]:
    _, e = jax.vmap(lambda chunk: _chunk(augmented, scales, v, active, chunk))(bare(chunks))
    return jnp.where(chunks.counts[..., None], e, 0.0)


@partial(jax.jit, static_argnames="augmented")
def innovations_of(augmented: Augmented, scales: Scales, v: Variables, chunks: Chunks) -> Float[Array, "C T-1 s"]:
    """Innovations in the outputs' units, zero in rows that do not count."""
    return _all(augmented, scales, v, augmented.active(v.theta, v.gated), chunks)


@partial(jax.jit, static_argnames="augmented")
def estimates_of(augmented: Augmented, scales: Scales, v: Variables, chunks: Chunks) -> Float[Array, "C T-1 s"]:
    """The estimates of the state that the steps to the innovations begin with, in rows that do not count as well."""
    active = augmented.active(v.theta, v.gated)
    return jax.vmap(lambda chunk: _chunk(augmented, scales, v, active, chunk)[0])(bare(chunks))


@partial(jax.jit, static_argnames="augmented")
def alone(augmented: Augmented, scales: Scales, v: Variables, theta: Theta, chunks: Chunks) -> Float[Array, "C T-1 s"]:
    """What each innovation would be, had its step alone been taken with other constants than those before it."""
    active = augmented.active(v.theta, v.gated, theta)
    return jax.vmap(lambda chunk: _chunk(augmented, scales, v, active, chunk, theta)[1])(bare(chunks))


@partial(jax.jit, static_argnames="augmented")
def tangents(
    augmented: Augmented,
    scales: Scales,
    v: Variables,
    phi: Float[Array, "M p"],
    gain: Float[Array, "M s"],
    cross: Float[Array, "M c"],
    chunks: Chunks,
) -> Float[Array, "M C T-1 s"]:
    """Derivatives of the innovations along M directions in phi and K."""
    active = augmented.active(v.theta, v.gated)

    def along(*direction: Float[Array, " k"]) -> Float[Array, "C T-1 s"]:
        at = lambda p, g, c: _all(augmented, scales, v._replace(phi=p, gain=g, cross=c), active, chunks)  # noqa: E731
        return jax.jvp(at, (v.phi, v.gain, v.cross), direction)[1]

    return jax.vmap(along)(phi, gain, cross)
