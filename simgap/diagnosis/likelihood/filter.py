"""Innovations: measurements minus their one-step predictions [Ljung 1999, prediction-error methods].

The state is measured with noise, so a regression on measured states is biased even if no physics is missing. Here the
simulator propagates an estimate x of the state, and each measurement y corrects it by a gain K:

    e_t = y_t - h(f(x_{t-1}, u_{t-1}))        x_t = f(x_{t-1}, u_{t-1}) + K e_t

K is fitted together with everything else. As in a Kalman filter it has off-diagonal entries: a jolt of the base moves
the hand as well, and a position informs about its velocity. With a diagonal gain, innovations would be predictable even
if no physics is missing. K is constant in the bodies' own frames.

An unmeasured state has no innovation; the others correct it through the off-diagonal entries.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.diagnosis.likelihood.segments import Chunks, bare
from simgap.diagnosis.likelihood.sent import begun_of, each_of, sent_by, start_of
from simgap.diagnosis.likelihood.traced import fading, move, remember_motion, sensed
from simgap.diagnosis.likelihood.variables import Variables, acting
from simgap.effects.augmented import Active, Augmented, Theta
from simgap.effects.effect import Memory, Row, Scales
from simgap.kinematics import to_own_frame, to_world, wrapped
from simgap.layout import Layout

LEAST_SLOPE = 0.05
"""Slope of a sensor below which its innovations are not divided by it."""


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


class _Segment(NamedTuple):
    """A segment, memory and state estimate at its beginning, k sets of constants, which effects act in any of them, and
    the commands that act with each."""

    chunk: Chunks
    begun: tuple[Memory, Float[Array, " s"]]
    thetas: Float[Array, "k P"]
    active: Active
    sent: Float[Array, "T-1 k ... u"]


def _filter_segment(
    augmented: Augmented, scales: Scales, v: Variables, segment: _Segment
) -> tuple[Float[Array, "T-1 s"], Float[Array, "T-1 o"]]:
    """State estimates at the beginning of the steps, and innovations.

    Each innovation is that of its own step taken with the last set of constants, and all earlier steps with the first.
    """
    chunk, begun, thetas, active, sent = segment
    K, phi = gain_matrix(augmented, scales, v), jnp.asarray(v.phi)

    def row(carry, now):
        memory, x = carry
        y_next, sent, time_s, next_s, interval, gate, table = now

        def step(theta: Theta, u: Float[Array, "... u"]) -> tuple[Memory, *tuple[Float[Array, " s"], ...]]:
            here, theta = Row(time_s, interval, table), acting(v, theta, gate)
            after, predicted = move(augmented, phi, theta, scales, memory, x, u, here, active)
            seen, slope = sensed(augmented, theta, after, predicted, here._replace(time_s=next_s), active)
            return after, predicted, innovation(augmented, y_next, seen), slope

        each = each_of(step, thetas, sent)
        after, predicted, e, slope = jax.tree.map(lambda a: a[0], each)
        reported = each[2][-1]
        outputs = len(augmented.layout.schema.outputs)
        return (after, corrected(augmented.layout, K, predicted, in_state(e, slope))), (x, reported[:outputs])

    times = (chunk.time_s[:-1], chunk.time_s[1:])
    rows = (chunk.state[1:], sent, *times, chunk.interval[:-1], chunk.gate[:, :-1].T, chunk.table)
    return jax.lax.scan(row, begun, rows)[1]


class Filtered(NamedTuple):
    """State estimates at the beginning of the steps, innovations of the observed outputs in their units, and the
    commands that act. Of all rows, including those that are not scored."""

    states: Float[Array, "C T-1 s"]
    innovations: Float[Array, "C T-1 o"]
    sent: Float[Array, "C T-1 ... u"]


def _filtered(
    augmented: Augmented, scales: Scales, v: Variables, chunks: Chunks, phi: Float[Array, " p"], *others: Theta
) -> Filtered:
    """phi: of the fading, so of the commands that act. others: each innovation is that of its own step with these."""
    active, thetas = augmented.active(v.theta, *v.delta, *others), jnp.stack([jnp.asarray(v.theta), *others])
    forgets = fading(augmented, phi, v.theta, active)

    def one(chunk: Chunks) -> Filtered:
        begun = begun_of(augmented, v, forgets, active, chunk)
        sent = sent_by(augmented, v, thetas, active, chunk, begun[0])
        found = _filter_segment(augmented, scales, v, _Segment(chunk, begun, thetas, active, sent))
        return Filtered(*found, sent[:, 0])

    return jax.vmap(one)(bare(chunks))


@partial(jax.jit, static_argnames="augmented")
def filtered(augmented: Augmented, scales: Scales, v: Variables, chunks: Chunks, phi: Float[Array, " p"]) -> Filtered:
    """The filter's result. phi: on which the commands that act depend: that of v, but for its derivatives."""
    return _filtered(augmented, scales, v, chunks, jnp.asarray(phi))


@partial(jax.jit, static_argnames="augmented")
def alone(augmented: Augmented, scales: Scales, v: Variables, theta: Theta, chunks: Chunks) -> Float[Array, "C T-1 o"]:
    """Innovations, each with its own step taken with constants `theta` and all earlier steps with those of v."""
    return _filtered(augmented, scales, v, chunks, jnp.asarray(v.phi), jnp.asarray(theta)).innovations


@partial(jax.jit, static_argnames="augmented")
def tangents(
    augmented: Augmented,
    scales: Scales,
    v: Variables,
    directions: tuple[Float[Array, "M p"], Float[Array, "M s"], Float[Array, "M c"]],
    chunks: Chunks,
    sent: Float[Array, "C T-1 ... u"],
) -> Float[Array, "M C T-1 o"]:
    """Derivatives of the innovations along M directions in phi and K (its diagonal, its off-diagonal entries).

    sent: the commands that act. They are held: to differentiate the laws on their way as well would take half of the
    time to compile, though they depend on phi by the fading alone (see `filtered`).
    """
    active, counts, thetas = augmented.active(v.theta, *v.delta), chunks.counts[..., None], jnp.asarray(v.theta)[None]

    def at(phi: Float[Array, " p"], gain: Float[Array, " s"], cross: Float[Array, " c"]) -> Float[Array, "C T-1 o"]:
        moved = v._replace(phi=phi, gain=gain, cross=cross)

        def one(chunk: Chunks, sent: Float[Array, "T-1 ... u"]) -> Float[Array, "T-1 o"]:
            at_start, first = start_of(augmented, v, chunk)
            bent, states = remember_motion(augmented, at_start, first, chunk.earlier, active)
            begun = Memory(chunk.command[:0], {}, bent, states, chunk.command[0]), first
            segment = _Segment(chunk, begun, thetas, active, sent[:, None])
            return _filter_segment(augmented, scales, moved, segment)[1]

        return jnp.where(counts, jax.vmap(one)(bare(chunks), sent), 0.0)

    return jax.vmap(lambda *along: jax.jvp(at, (v.phi, v.gain, v.cross), along)[1])(*directions)
