"""Supports: when, where and in which sessions an effect acts."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from simgap.diagnosis.config import SHORTEST_PUSH
from simgap.diagnosis.hypotheses.features import inside
from simgap.diagnosis.likelihood.segments import Chunks, Rows
from simgap.effects.regime import Regime, words
from simgap.layout import Layout


@dataclass(frozen=True)
class Always:
    """In every row."""


@dataclass(frozen=True)
class From:
    """From a time [s] after the session's start, in every session."""

    from_s: float


@dataclass(frozen=True)
class Window:
    """Between two times [s] after the start of one session, given by its index."""

    session: int
    from_s: float
    to_s: float


@dataclass(frozen=True)
class Since:
    """In all sessions after the `first` ones, the baseline."""

    first: int


Support = Always | From | Window | Regime | Since
ALWAYS = Always()
NOWHERE = Window(-1, 0.0, 0.0)


def mask(layout: Layout, support: Support, chunks: Chunks) -> Bool[np.ndarray, "C T"]:
    """Which rows are in a support; a regime is evaluated on the measured state."""
    time_s, session = np.asarray(chunks.time_s), np.asarray(chunks.session)[:, None]
    match support:
        case Always():
            return np.full(time_s.shape, True)
        case From(from_s):
            return time_s >= from_s
        case Window():
            return within(Rows(session, time_s), support)
        case Since(first):
            return np.broadcast_to(session >= first, time_s.shape)
        case regime:
            return inside(layout, regime, chunks)


def opened(layout: Layout, chunks: Chunks, supports: Sequence[Support]) -> Chunks:
    """Segments with one gate per support; without supports, with one gate that is always open."""
    gates = [mask(layout, support, chunks) for support in supports or [ALWAYS]]
    return chunks._replace(gate=jnp.asarray(np.stack(gates, axis=1), jnp.float32))


def for_heldout(layout: Layout, unseen: Chunks, supports: Sequence[Support]) -> Chunks:
    """Held-out segments with one gate per support; a window lies in a fitted session, so its gate is closed."""
    return opened(layout, unseen, [NOWHERE if isinstance(s, Window) else s for s in supports])


def in_words(layout: Layout, support: Support) -> str:
    """Short description: `where reach > 0.9 m`, `from 3.2 s on`, `from 3.2 to 5.0 s of one session`."""
    match support:
        case Regime():
            return f"where {words(layout, support)}"
        case From(from_s):
            return f"from {from_s:.1f} s on"
        case Window(_, from_s, to_s):
            return f"from {from_s:.1f} to {to_s:.1f} s of one session"
        case Since():
            return "since the baseline"
        case Always():
            return "throughout"


def within(rows: Rows, window: Window, margin_s: float = 0.0) -> Bool[np.ndarray, "..."]:
    """Which rows are in a window, extended within its session by a margin [s] on either side."""
    time_s = rows.time_s
    return (rows.session == window.session) & (time_s >= window.from_s - margin_s) & (time_s < window.to_s + margin_s)


def elsewhere(rows: Rows, window: Window, score: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Scores outside a window; zero in it and in `SHORTEST_PUSH` rows at either side, where it still acts."""
    return np.where(within(rows, window, SHORTEST_PUSH * float(np.median(np.diff(rows.time_s)))), 0.0, score)


def at_start(rows: Rows, window: Window) -> bool:
    """Whether a window begins in the first `SHORTEST_PUSH` rows of its session."""
    time_s = np.sort(rows.time_s[rows.session == window.session])
    return window.from_s <= time_s[min(SHORTEST_PUSH, len(time_s)) - 1]


def to_its_end(rows: Rows, window: Window) -> bool:
    """Whether a window lasts to the end of its session."""
    return window.to_s > rows.time_s[rows.session == window.session].max()
