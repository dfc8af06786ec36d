"""Innovations: measurements minus their one-step predictions [Ljung 1999, prediction-error methods].

The state is measured with noise, so a regression on measured states is biased even if no physics is missing. Here the
simulator propagates an estimate x of the state, and each measurement y corrects it by a gain K:

    e_t = y_t - h(f(x_{t-1}, u_{t-1}))        x_t = f(x_{t-1}, u_{t-1}) + K e_t

K is fitted together with everything else. As in a Kalman filter it has off-diagonal entries: a jolt of the base moves
the hand as well, and a position informs about its velocity. With a diagonal gain, innovations would be predictable even
if no physics is missing. K is constant in the bodies' own frames.

An unmeasured state has no innovation; the others correct it through the off-diagonal entries.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.diagnosis.likelihood.segments import Chunks, bare
from simgap.diagnosis.likelihood.traced import advance, remember, sensed
from simgap.effects.augmented import Active, Augmented, Theta
from simgap.effects.effect import Memory, Row, Scales
from simgap.effects.step import follow, unsense
from simgap.effects.stepping import terms_of
from simgap.kinematics import to_own_frame, to_world, wrapped
from simgap.layout import Layout

LEAST_SLOPE = 0.05
"""Slope of a sensor below which its innovations are not divided by it."""


class Variables(NamedTuple):
    """All that can be fitted.

    phi: simulator parameters. gain: diagonal of K. cross: its off-diagonal entries (`Layout.akin`). theta: effects'
    constants. delta: how much these differ where each of S supports is open.
    """

    phi: Float[np.ndarray, " p"]
    gain: Float[np.ndarray, " s"]
    cross: Float[np.ndarray, " c"]
    theta: Float[np.ndarray, " P"]
    delta: Float[np.ndarray, "S P"]


def innovation(augmented: Augmented, y: Float[Array, "... s"], seen: Float[Array, "... s"]) -> Float[Array, "... s"]:
    """Measurement minus prediction; zero for states that are not measured."""
    e, observed = wrapped(augmented.layout, y - seen), augmented.layout.observed
    return e if observed.all() else jnp.where(observed, e, 0.0)


def in_state(e: Float[Array, "... s"], slope: Float[Array, "... s"]) -> Float[Array, "... s"]:
    """The change of the state that changes its measurement by an innovation. slope: of the sensors (`step.sensed`).

    Without it, a scale of a sensor would also be a gain of the filter beyond its bound. Where a sensor shows almost
    nothing of a change, the innovation itself.
    """
    return e / jnp.where(jnp.abs(slope) < LEAST_SLOPE, 1.0, slope)


def gain_matrix(augmented: Augmented, scales: Scales, v: Variables) -> Float[Array, "s s"]:
    """K, in the bodies' own frames.

    Off-diagonal entries are fitted in units of the time step, so that all are of order one: an innovation of one
    millimetre corrects a velocity by the order of one millimetre per time step. Those of a state that is `apart` are in
    units of its usual size over that of what is measured.
    """
    layout = augmented.layout
    rate = np.array([f.kind == "velocity" for f in layout.schema.state], float)
    i, j = np.array(layout.akin, int).reshape(-1, 2).T
    unit = augmented.simulator.time_step ** (rate[j] - rate[i])
    if layout.apart.any():
        size = jnp.asarray(scales.output)
        unit = jnp.where(layout.apart[i], size[i] / size[j], unit)
    return jnp.diag(v.gain).at[i, j].set(v.cross * unit)


def corrected(
    layout: Layout, K: Float[Array, "s s"], x: Float[Array, " s"], e: Float[Array, " s"]
) -> Float[Array, " s"]:
    """x + K e, with K in the bodies' own frames."""
    return x + to_world(layout, K @ to_own_frame(layout, e, x), x)


def acting(v: Variables, theta: Theta, gate: Sequence[Float[Array, ""]] | Float[Array, " S"]) -> Theta:
    """Constants in one row: theta + sum_s gate_s delta_s."""
    for s in range(len(v.delta)):
        theta = theta + gate[s] * v.delta[s]
    return theta


def _filter_segment(
    augmented: Augmented, scales: Scales, v: Variables, active: Active, chunk: Chunks, other: Theta | None = None
) -> tuple[Float[Array, "T-1 s"], Float[Array, "T-1 o"]]:
    """State estimates at the beginning of the steps, and innovations, of one segment (without its leading axis C).

    With `other` constants, each innovation is that of its own step taken with these, and all earlier steps with v's.
    """
    K, phi = gain_matrix(augmented, scales, v), jnp.asarray(v.phi)
    at_start = acting(v, v.theta, chunk.gate[:, 0])
    first = unsense(augmented, at_start, chunk.state[0], chunk.time_s[0])
    memory = remember(augmented, phi, at_start, first, chunk.earlier, chunk.time_s[0], active)

    def row(carry, now):
        memory, x = carry
        y_next, u, time_s, next_s, interval, gate, table = now

        def step(theta: Theta) -> tuple[Memory, *tuple[Float[Array, " s"], ...]]:
            here, theta = Row(time_s, interval, table), acting(v, theta, gate)
            after, predicted = advance(augmented, phi, theta, scales, memory, x, u, here, active)
            seen, slope = sensed(augmented, theta, after, predicted, here._replace(time_s=next_s), active)
            return after, predicted, innovation(augmented, y_next, seen), slope

        if other is None:
            after, predicted, e, slope = step(v.theta)
            reported = e
        else:
            # Map over both sets of constants, so that the step is compiled once.
            both = jax.lax.map(step, jnp.stack([v.theta, other]))
            after, predicted, e, slope = jax.tree.map(lambda a: a[0], both)
            _, _, innovations, _ = both
            reported = innovations[1]
        outputs = len(augmented.layout.schema.outputs)
        return (after, corrected(augmented.layout, K, predicted, in_state(e, slope))), (x, reported[:outputs])

    times = (chunk.time_s[:-1], chunk.time_s[1:])
    rows = (chunk.state[1:], chunk.command[:-1], *times, chunk.interval[:-1], chunk.gate[:, :-1].T, chunk.table)
    return jax.lax.scan(row, (memory, first), rows)[1]


@partial(jax.jit, static_argnames="augmented")
def filtered(
    augmented: Augmented, scales: Scales, v: Variables, chunks: Chunks
) -> tuple[Float[Array, "C T-1 s"], Float[Array, "C T-1 o"]]:
    """State estimates at the beginning of the steps, and innovations of the observed outputs in their units.

    Of all rows, including those that are not scored.
    """
    active = augmented.active(v.theta, *v.delta)
    return jax.vmap(lambda chunk: _filter_segment(augmented, scales, v, active, chunk))(bare(chunks))


def terms_in_rows(augmented: Augmented, v: Variables, chunks: Chunks) -> Float[np.ndarray, "C T-1 k"]:
    """An engine's terms in each row."""

    def terms(gate: Float[Array, " S"]) -> Float[Array, " k"]:
        values = terms_of(augmented, acting(v, v.theta, gate))
        assert values is not None  # an engine has them
        return values

    return np.asarray(jax.vmap(jax.vmap(terms))(jnp.swapaxes(chunks.gate[..., :-1], 1, 2)))


@partial(jax.jit, static_argnames="augmented")
def sent_of(augmented: Augmented, v: Variables, chunks: Chunks) -> Float[Array, "C T-1 parts u"]:
    """Commands that act in each part of an engine's rows."""
    active = augmented.active(v.theta, *v.delta)

    def one(chunk: Chunks) -> Float[Array, "T-1 parts u"]:
        at_start = acting(v, v.theta, chunk.gate[:, 0])
        memory = remember(
            augmented, jnp.asarray(v.phi), at_start, chunk.state[0], chunk.earlier, chunk.time_s[0], active
        )

        def row(memory: Memory, now: tuple) -> tuple[Memory, Float[Array, "parts u"]]:
            u, time_s, interval, gate = now
            return follow(augmented, acting(v, v.theta, gate), memory, u, Row(time_s, interval), active)

        rows = (chunk.command[:-1], chunk.time_s[:-1], chunk.interval[:-1], chunk.gate[:, :-1].T)
        return jax.lax.scan(row, memory, rows)[1]

    return jax.vmap(one)(bare(chunks)._replace(table=None))


@partial(jax.jit, static_argnames="augmented")
def alone(augmented: Augmented, scales: Scales, v: Variables, theta: Theta, chunks: Chunks) -> Float[Array, "C T-1 o"]:
    """Innovations, each with its own step taken with constants `theta` and all earlier steps with those of v."""
    active = augmented.active(v.theta, *v.delta, theta)
    return jax.vmap(lambda chunk: _filter_segment(augmented, scales, v, active, chunk, theta)[1])(bare(chunks))


@partial(jax.jit, static_argnames="augmented")
def tangents(
    augmented: Augmented,
    scales: Scales,
    v: Variables,
    directions: tuple[Float[Array, "M p"], Float[Array, "M s"], Float[Array, "M c"]],
    chunks: Chunks,
) -> Float[Array, "M C T-1 o"]:
    """Derivatives of the innovations along M directions in phi and K (its diagonal, its off-diagonal entries)."""
    active, counts = augmented.active(v.theta, *v.delta), chunks.counts[..., None]

    def at(phi: Float[Array, " p"], gain: Float[Array, " s"], cross: Float[Array, " c"]) -> Float[Array, "C T-1 o"]:
        moved = v._replace(phi=phi, gain=gain, cross=cross)
        _, e = jax.vmap(lambda chunk: _filter_segment(augmented, scales, moved, active, chunk))(bare(chunks))
        return jnp.where(counts, e, 0.0)

    return jax.vmap(lambda *along: jax.jvp(at, (v.phi, v.gain, v.cross), along)[1])(*directions)
