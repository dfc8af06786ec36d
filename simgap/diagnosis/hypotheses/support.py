"""When an effect acts: from a time on in every session, during a stretch of one session, or in a regime."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from simgap.diagnosis.hypotheses.features import inside
from simgap.diagnosis.likelihood.segments import Chunks, Rows
from simgap.effects.regime import Regime, words
from simgap.layout import Layout

PUSH = 8
"""Rows of the shortest push."""
LASTING = 50
"""Rows of the shortest stretch in which a law of motion may hold and not elsewhere."""


class When(NamedTuple):
    """Session (index, None for all), time [s] since its start, and regime (None for all)."""

    session: int | None = None
    from_s: float = 0.0
    to_s: float = np.inf
    regime: Regime | None = None


NEVER = When(to_s=0.0)
"""Open in no row: what acts in one session of training is closed in held-out ones."""


def in_words(layout: Layout, when: When) -> str:
    """In short: `where reach > 0.9 m`, `from 3.2 s on`."""
    return f"where {words(layout, when.regime)}" if when.regime is not None else f"from {when.from_s:.1f} s on"


def opened(layout: Layout, chunks: Chunks, supports: Sequence[When]) -> Chunks:
    """Chunks with a gate for each support; a single one, always open, where there are none."""
    gates = [_gate(layout, chunks, when) for when in supports or [When()]]
    return chunks._replace(gate=jnp.asarray(np.stack(gates, axis=1), jnp.float32))


def _gate(layout: Layout, chunks: Chunks, when: When) -> Bool[np.ndarray, "C T"]:
    """Where an effect acts; in a regime, as measured."""
    time = np.asarray(chunks.time_s)
    acts = (time >= when.from_s) & (time < when.to_s)
    if when.session is not None:
        acts &= (np.asarray(chunks.session) == when.session)[:, None]
    if when.regime is not None:
        acts &= inside(layout, when.regime, chunks)
    return acts


def elsewhere(rows: Rows, when: When, score: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Scores of the rows outside of a stretch, nil in it and in the `PUSH` rows beside it, where it still echoes."""
    margin = PUSH * float(np.median(np.diff(rows.time_s)))
    inside = (rows.time_s >= when.from_s - margin) & (rows.time_s < when.to_s + margin)
    inside &= rows.session == when.session
    return np.where(inside, 0.0, score)


def at_start(rows: Rows, when: When) -> bool:
    """Whether a stretch begins in the first `PUSH` rows of its session."""
    time_s = np.sort(rows.time_s[rows.session == when.session])
    return when.from_s <= time_s[min(PUSH, len(time_s)) - 1]


def to_its_end(rows: Rows, when: When) -> bool:
    """Whether a stretch lasts to the end of its session."""
    return when.session is not None and when.to_s > rows.time_s[rows.session == when.session].max()
