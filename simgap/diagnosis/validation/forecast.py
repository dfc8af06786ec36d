"""Multi-step predictions, from a state estimate that measurements correct up to the start."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.diagnosis.likelihood.filter import corrected, gain_matrix, in_state, innovation
from simgap.diagnosis.likelihood.problem import Problem
from simgap.diagnosis.likelihood.segments import RUN_IN, Chunks, as_chunks, excerpt, sources_of
from simgap.diagnosis.likelihood.signs import signed
from simgap.diagnosis.likelihood.traced import advance, fading, remember, sensed
from simgap.diagnosis.likelihood.variables import Variables, acting
from simgap.diagnosis.validation.black_box import BlackBox, correct, silent
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Earlier, Memory, Row, Scales
from simgap.effects.regime import EVERYWHERE, Regime, holds
from simgap.effects.step import unsense
from simgap.types import Recording

PIECES, SEGMENT = 64, 10
"""Pieces, and rows of them, that are computed at once: one size for all horizons, since each size is compiled anew."""

FEW = 1
"""With at most this many effects, forecasts are compiled without the laws of all others (see `Augmented.lean`)."""


def windows(recordings: Sequence[Recording], time_step: float, horizon: int, stride: int) -> Chunks | None:
    """Pieces of RUN_IN + horizon + 1 rows, one every `stride` rows; None if all sessions are too short."""
    always = np.ones(RUN_IN + horizon, bool)
    firsts = [(s, first) for s, r in enumerate(recordings) for first in range(0, len(r.time_s) - len(always), stride)]
    sources = sources_of(recordings)
    parts = [excerpt(sources[s], first, always, time_step) for s, first in firsts]
    return as_chunks(parts) if parts else None


def window(recording: Recording, time_step: float, horizon: int, first: int) -> Chunks:
    """The piece that begins at row `first` of a recording."""
    (source,) = sources_of([recording])
    return as_chunks([excerpt(source, first, np.ones(RUN_IN + horizon, bool), time_step)])


Regimes = tuple[Regime, ...]
"""One per support; `EVERYWHERE` for a support without a regime."""


class Contestant(NamedTuple):
    """A model that forecasts: its variables, its black box if it has one, and the regimes of its supports."""

    v: Variables
    box: BlackBox | None = None
    regimes: Regimes = (EVERYWHERE,)


def forecast(problem: Problem, model: Contestant, pieces: Chunks) -> Float[np.ndarray, "W h s"]:
    """Predicted measurements of the rows after each piece's run-in, without corrections.

    An effect with a support acts where its gate is open and the predicted state is in its regime.
    """
    # The sign at a start is found in the run-in: what comes after it is to be forecast.
    in_run_in = np.broadcast_to(np.arange(pieces.counts.shape[1]) < RUN_IN, pieces.counts.shape)
    pieces = signed(problem._replace(chunks=pieces), model.v, in_run_in).chunks
    augmented, scales = problem.augmented.lean(FEW, model.v.theta, model.v.delta), problem.scales
    model = model if model.box is not None else model._replace(box=silent(augmented.layout))
    count = len(pieces.row)
    parts = []
    for first in range(0, count, PIECES):
        # The last batch is filled up by repetition.
        index = np.minimum(np.arange(first, first + PIECES), count - 1)
        batch = jax.tree.map(lambda a, index=index: np.asarray(a)[index], pieces)
        parts.append(_forecast(augmented, scales, model, batch)[: count - first])
    return np.concatenate(parts)


def _forecast(augmented: Augmented, scales: Scales, model: Contestant, pieces: Chunks) -> Float[np.ndarray, "W h s"]:
    steps = pieces.state.shape[1] - 1
    trust = np.broadcast_to(np.arange(steps) < RUN_IN, (PIECES, steps)).astype(np.float32)
    times = (pieces.time_s[:, :-1], pieces.time_s[:, 1:])
    rows = (
        pieces.state[:, 1:],
        pieces.command[:, :-1],
        *times,
        pieces.interval[:, :-1],
        np.swapaxes(pieces.gate[..., :-1], 1, 2),
        trust,
    )
    filtered = _begin(augmented, model.v, pieces.state[:, 0], pieces.earlier, pieces.time_s[:, 0])
    parts = []
    for first in range(0, steps, SEGMENT):
        # The last segment is filled up by repetition.
        index = np.minimum(np.arange(first, first + SEGMENT), steps - 1)
        filtered, predicted = _segment(augmented, scales, model, filtered, tuple(a[:, index] for a in rows))
        parts.append(np.asarray(predicted))
    return np.concatenate(parts, axis=1)[:, RUN_IN:steps]


_Filtered = tuple[Memory, Float[Array, "W s"]]
"""Memory and estimated state at the end of a segment."""


@partial(jax.jit, static_argnames="augmented")
def _begin(
    augmented: Augmented,
    v: Variables,
    state: Float[Array, "W s"],
    earlier: Earlier,
    time_s: Float[Array, " W"],
) -> _Filtered:
    active = augmented.active(v.theta, *v.delta)

    def one(state: Array, earlier: Earlier, time_s: Array) -> tuple[Memory, Array]:
        first = unsense(augmented, v.theta, state, time_s)
        return remember(augmented, forgets, v.theta, first, earlier, time_s, active), first

    forgets = fading(augmented, jnp.asarray(v.phi), v.theta, active)
    return jax.vmap(one)(state, earlier, time_s)


@partial(jax.jit, static_argnames="augmented")
def _segment(
    augmented: Augmented,
    scales: Scales,
    model: Contestant,
    filtered: _Filtered,
    rows: tuple[Array, ...],
) -> tuple[_Filtered, Float[Array, "W t s"]]:
    v, box, regimes = model
    assert box is not None  # set by `forecast`
    phi, K = jnp.asarray(v.phi), gain_matrix(augmented, scales, v)
    active = augmented.active(v.theta, *v.delta)

    def row(carry, now):
        memory, x = carry
        y_next, u, time_s, next_s, interval, gate, trust = now
        gates = [gate[s] * holds(augmented.layout, regime, x, u) for s, regime in enumerate(regimes)]
        theta = acting(v, v.theta, gates)
        sent = jnp.concatenate([u[None], memory.commands])
        added = correct(augmented.layout, box, x, sent)
        timing = Row(time_s, interval)
        memory, x = advance(augmented, phi, theta, scales, memory, x, u, timing, active)
        # In the run-in the filter works without the box, as it did when the box was trained on its innovations.
        x = x + (1 - trust) * added
        y, slope = sensed(augmented, theta, memory, x, timing._replace(time_s=next_s), active)
        e = in_state(innovation(augmented, y_next, y), slope)
        return (memory, corrected(augmented.layout, trust * K, x, e)), y

    return jax.vmap(lambda filtered, rows: jax.lax.scan(row, filtered, rows))(filtered, rows)
