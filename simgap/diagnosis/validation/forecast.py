"""Predictions over many steps, from an estimate of the state that measurements corrected up to the start."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.diagnosis.likelihood.filter import Variables, acting, corrected, gain_matrix, innovation
from simgap.diagnosis.likelihood.problem import Problem
from simgap.diagnosis.likelihood.segments import RUN_IN, Chunks, as_chunks, sent_before
from simgap.diagnosis.likelihood.traced import advance, remember, sense
from simgap.diagnosis.validation.black_box import BlackBox, correct, silent
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Memory, Row, Scales
from simgap.effects.regime import EVERYWHERE, Regime, holds
from simgap.effects.step import unsense
from simgap.types import Recording

PIECES, SEGMENT = 64, 10
"""Pieces, and rows of them, that are computed at once: one size whatever the horizon, for each is compiled anew."""

FEW = 1
"""Effects at most for which the program of forecasts leaves out the others: it has no more than was found."""


def windows(recordings: Sequence[Recording], time_step: float, horizon: int, stride: int) -> Chunks | None:
    """Pieces of RUN_IN + horizon + 1 rows, every `stride` rows; None where all sessions are too short for one."""
    rows = RUN_IN + horizon + 1
    parts: list[tuple] = []
    for s, r in enumerate(recordings):
        interval = np.append(np.diff(r.time_s) / time_step, 1.0)
        for first in range(0, len(r.time_s) - rows + 1, stride):
            index = np.arange(first, first + rows)
            times = r.time_s[index] - r.time_s[0], interval[index]
            always = np.ones(rows - 1, bool), np.ones((1, rows))
            parts.append((r.state[index], r.command[index], *sent_before(r.command, first), *times, *always, s, first))
    return as_chunks(parts) if parts else None


Regimes = tuple[Regime, ...]
"""Of every support; `EVERYWHERE` where it has none."""


class Contestant(NamedTuple):
    """A model that forecasts: its variables, what a black box adds, and the regimes of its supports."""

    v: Variables
    box: BlackBox | None = None
    regimes: Regimes = (EVERYWHERE,)


def forecast(problem: Problem, model: Contestant, pieces: Chunks) -> Float[np.ndarray, "W h s"]:
    """Predicted measurements of the rows after each piece's run-in; nothing corrects them.

    What has a support acts where its gate is open and the robot is, as predicted, in its regime.
    """
    augmented, scales = problem.augmented.lean(FEW, model.v.theta, model.v.delta), problem.scales
    model = model if model.box is not None else model._replace(box=silent(augmented.layout))
    count = len(pieces.row)
    parts = []
    for first in range(0, count, PIECES):
        # The last batch is filled up by repetition.
        index = np.minimum(np.arange(first, first + PIECES), count - 1)
        some = jax.tree.map(lambda a, index=index: np.asarray(a)[index], pieces)
        parts.append(_forecast(augmented, scales, model, some)[: count - first])
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
    going = _begin(augmented, model.v, pieces.state[:, 0], pieces.past, pieces.time_s[:, 0], pieces.turns)
    parts = []
    for first in range(0, steps, SEGMENT):
        # The last segment is filled up by repetition.
        index = np.minimum(np.arange(first, first + SEGMENT), steps - 1)
        going, seen = _go_on(augmented, scales, model, going, tuple(a[:, index] for a in rows))
        parts.append(np.asarray(seen))
    return np.concatenate(parts, axis=1)[:, RUN_IN:steps]


_Going = tuple[Memory, Float[Array, "W s"]]
"""Memory and estimated state at the end of a segment."""


@partial(jax.jit, static_argnames="augmented")
def _begin(
    augmented: Augmented,
    v: Variables,
    state: Float[Array, "W s"],
    past: Float[Array, "W h u"],
    time_s: Float[Array, " W"],
    turns: Float[Array, "W m u"],
) -> _Going:
    active = augmented.active(v.theta, *v.delta)

    def one(state: Array, past: Array, time_s: Array, turns: Array) -> tuple[Memory, Array]:
        first = unsense(augmented, v.theta, state, time_s)
        return remember(augmented, jnp.asarray(v.phi), v.theta, first, past, time_s, turns, active), first

    return jax.vmap(one)(state, past, time_s, turns)


@partial(jax.jit, static_argnames="augmented")
def _go_on(
    augmented: Augmented,
    scales: Scales,
    model: Contestant,
    going: _Going,
    rows: tuple[Array, ...],
) -> tuple[_Going, Float[Array, "W t s"]]:
    v, box, regimes = model
    assert box is not None  # `forecast` gave it one
    phi, K = jnp.asarray(v.phi), gain_matrix(augmented, v)
    active = augmented.active(v.theta, *v.delta)

    def row(carry, now):
        memory, x = carry
        y_next, u, time_s, next_s, interval, gate, trust = now
        there = [gate[s] * holds(augmented.layout, regime, x, u) for s, regime in enumerate(regimes)]
        theta = acting(v, v.theta, there)
        sent = jnp.concatenate([u[None], memory.commands])
        added = correct(augmented.layout, box, x, sent)
        here = Row(time_s, interval)
        memory, x = advance(augmented, phi, theta, scales, memory, x, u, here, active)
        # While measurements correct the filter it runs as it did when the box was trained on what it leaves over.
        x = x + (1 - trust) * added
        seen = sense(augmented, theta, memory, x, here._replace(time_s=next_s), active)
        return (memory, corrected(augmented.layout, trust * K, x, innovation(augmented, y_next, seen))), seen

    return jax.vmap(lambda going, rows: jax.lax.scan(row, going, rows))(going, rows)
