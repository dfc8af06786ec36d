"""Predictions over many steps, from an estimate of the state that measurements corrected up to the start."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.diagnosis.black_box import BlackBox, correct
from simgap.diagnosis.innovations import (
    RUN_IN,
    Chunks,
    Variables,
    as_chunks,
    bare,
    corrected,
    gain_matrix,
    sent_before,
    wrap,
)
from simgap.effects.augmented import Augmented, advance, remember, sense, unsense
from simgap.effects.effect import Row, Scales
from simgap.types import Recording


def windows(recordings: Sequence[Recording], time_step: float, horizon: int, stride: int) -> Chunks | None:
    """Pieces of RUN_IN + horizon + 1 rows, every `stride` rows; None where all sessions are too short for one."""
    rows = RUN_IN + horizon + 1
    parts: list[tuple] = []
    for s, r in enumerate(recordings):
        interval = np.append(np.diff(r.time_s) / time_step, 1.0)
        for first in range(0, len(r.time_s) - rows + 1, stride):
            index = np.arange(first, first + rows)
            parts.append((r.state[index], r.command[index], *sent_before(r.command, first),
                          r.time_s[index] - r.time_s[0], interval[index], np.ones(rows - 1, bool), np.ones(rows), s,
                          first))  # fmt: skip
    return as_chunks(parts) if parts else None


@partial(jax.jit, static_argnames="augmented")
def forecast(
    augmented: Augmented, scales: Scales, v: Variables, pieces: Chunks, box: BlackBox
) -> Float[Array, "W h s"]:
    """Predicted measurements of the rows after each piece's run-in, never corrected again; `box` adds to every step."""
    phi, K = jnp.asarray(v.phi), gain_matrix(augmented, v)
    active = augmented.active(v.theta, v.gated)

    def one(chunk: Chunks) -> Float[Array, "h s"]:
        first = unsense(augmented, v.theta, chunk.state[0], chunk.time_s[0])
        memory = remember(augmented, v.theta, first, chunk.past, chunk.time_s[0], chunk.turns, active)

        def row(carry, now):
            memory, x = carry
            y_next, u, time_s, next_s, interval, gate, trust = now
            theta = v.theta + gate * v.gated
            sent = jnp.concatenate([u[None], memory.commands])
            added = correct(augmented.layout, box, x, sent)
            here = Row(time_s, interval)
            memory, x = advance(augmented, phi, theta, scales, memory, x, u, here, active)
            x = x + added
            seen = sense(augmented, theta, memory, x, here._replace(time_s=next_s), active)
            return (memory, corrected(augmented.layout, trust * K, x, wrap(augmented, y_next - seen))), seen

        steps = len(chunk.state) - 1
        trust = (jnp.arange(steps) < RUN_IN).astype(jnp.float32)
        times = (chunk.time_s[:-1], chunk.time_s[1:])
        rows = (chunk.state[1:], chunk.command[:-1], *times, chunk.interval[:-1], chunk.gate[:-1], trust)
        return jax.lax.scan(row, (memory, first), rows)[1][RUN_IN:]

    return jax.vmap(one)(bare(pieces))
