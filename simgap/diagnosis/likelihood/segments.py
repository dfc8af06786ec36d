"""Sessions cut into segments that run in parallel, and which of their rows are scored.

Each segment begins with a few run-in rows, in which the estimate forgets its start. They are not scored.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from simgap.diagnosis.likelihood.ways import Ways, reached, ways_of
from simgap.effects.effect import HISTORY_ROWS, Earlier
from simgap.engines import Engine, Table, is_engine
from simgap.types import Recording, StepModel

LENGTH = 40
"""Scored rows of a segment."""
RUN_IN = 10
"""Run-in rows before them, in which the estimate forgets its start."""
FIRST = 2
"""Steps at the start of a session that are run-in as well: the estimate starts at a measured state."""
WARM = 30
"""Rows of past commands that run through the command path before a segment, so that lags start in the right state."""
TURNS = 12
"""Turning points of each command before those rows, so that play starts in the right state; a real Spot has no more."""
MOST, MOST_OF_ENGINE = 16_000, 1_600
"""Rows at most that are searched, and those with an engine, whose tables take a hundred evaluations a row. What only
more rows would show is smaller than the misfit of any law on a real machine."""
FEWEST, FEW, SIZES = 16, 16, 4
"""Least number of segments, the next number, and how many numbers there are between one power of two and the next.
Segments are padded to these numbers, so that recording sets of similar size share compiled code."""


class Chunks(NamedTuple):
    """Sessions cut into C segments of T = RUN_IN + LENGTH + 1 rows.

    past, turns: see `sent_before`. came: see `ways.reached`. counts: whether row t + 1 of
    the segment is scored. gate: 1 where support s is open, else 0. session: index into the recordings. row: index of
    the segment's first row in its session. table: an engine's steps near an estimate of every row but the last;
    without it, the simulator itself is run.
    """

    state: Float[Array, "C T s"]
    command: Float[Array, "C T u"]
    past: Float[Array, "C h u"]
    turns: Float[Array, "C m u"]
    came: Float[Array, "C w s"]
    time_s: Float[Array, "C T"]
    interval: Float[Array, "C T"]
    counts: Bool[Array, "C T-1"]
    gate: Float[Array, "C S T"]
    session: Int[np.ndarray, " C"]
    row: Int[np.ndarray, " C"]
    table: Table | None = None

    @property
    def earlier(self) -> Earlier:
        """What is known of the rows before the segments."""
        return Earlier(self.past, self.turns, self.came)


def sent_before(
    command: Float[np.ndarray, "T u"], row: int
) -> tuple[Float[np.ndarray, "h u"], Float[np.ndarray, "m u"]]:
    """Commands before a row of a session: the last HISTORY_ROWS + WARM ones, and each command's turning points before
    the last WARM rows; both latest first. Before the session, its first command is taken to have been constant."""
    past = command[np.maximum(row - 1 - np.arange(HISTORY_ROWS + WARM), 0)]
    return past, np.reshape([_turns(u) for u in command[: max(row - WARM, 1)].T], (-1, TURNS)).T


class Source(NamedTuple):
    """A session to cut segments from: its number, its recording, and how its states were reached."""

    session: int
    recording: Recording
    ways: Ways


def sources_of(recordings: Sequence[Recording]) -> list[Source]:
    """The sessions, in order."""
    return [Source(s, r, ways_of(r.state)) for s, r in enumerate(recordings)]


def _turns(u: Float[np.ndarray, " T"]) -> Float[np.ndarray, " m"]:
    """The last value, and the highs and lows before it that no later one exceeds, latest first.

    They alone determine the state of play, whatever its gap and however long the command has rested since: a swing
    pushes it, and a wider swing overrides narrower ones before it. If there are too many, the widest are left out. The
    oldest is zero: before its session a robot stood still, with the play in the middle of its gap.
    """
    back = u[::-1]
    side = np.sign(np.diff(np.maximum.accumulate(back))) + np.sign(np.diff(np.minimum.accumulate(back)))
    (exceeding,) = side.nonzero()  # one row further back a new high (1) or low (-1) is reached
    widest = exceeding[np.diff(side[exceeding], append=0) != 0] + 1
    values = np.concatenate([back[:1], back[widest]])[: TURNS - 1]
    return np.concatenate([values, np.zeros(TURNS - len(values))])


def cut(recordings: Sequence[Recording], time_step: float, least: int = 0, most: int = MOST) -> Chunks:
    """Segments of all sessions, or at regular intervals if they have more than `most` rows; the last one of a session
    is padded with rows that are not scored.

    Unscored segments pad their number, to at least `least`: sets of the same number share compiled code.
    """
    sources = sources_of(recordings)
    firsts = [(s, first) for s, r in enumerate(recordings) for first in range(0, max(len(r.time_s) - 1, 1), LENGTH)]
    if len(firsts) > most // LENGTH:
        firsts = [firsts[i] for i in np.linspace(0, len(firsts) - 1, most // LENGTH).round().astype(int)]
    parts = [_segment(sources[s], first, time_step) for s, first in firsts]
    *arrays, counted, gate, s, start = parts[0]
    padding = (*arrays, np.zeros_like(counted), gate, s, start)
    return as_chunks([*parts, *[padding] * (max(filled(len(parts)), least) - len(parts))])


def scorable(recordings: Sequence[Recording]) -> int:
    """Number of rows that `cut` scores if it leaves none out: all but the first ones of each session."""
    return sum(max(len(r.time_s) - 1 - FIRST, 0) for r in recordings)


def _segment(source: Source, first: int, time_step: float) -> tuple:
    """Fields of the segment of a session whose scored rows begin at row `first`."""
    start, r = max(first - RUN_IN, 0), source.recording
    successor = np.arange(start + 1, start + RUN_IN + LENGTH + 1)
    counted = (successor > max(first, FIRST)) & (successor <= min(first + LENGTH, len(r.time_s) - 1))
    return excerpt(source, start, counted, time_step)


def excerpt(source: Source, start: int, counted: Bool[np.ndarray, " t"], time_step: float) -> tuple:
    """Fields of a segment of a session, from row `start` to the one after the last transition in `counted`.

    After the last row of a session there is no step; nothing depends on its interval.
    """
    r = source.recording
    steps, rows = len(r.time_s) - 1, len(counted) + 1
    index = np.minimum(np.arange(start, start + rows), steps)
    time_s, interval = r.time_s[index], (r.time_s[np.minimum(index + 1, steps)] - r.time_s[index]) / time_step
    return (r.state[index], r.command[index], *sent_before(r.command, start), reached(source.ways, start),
            time_s - r.time_s[0], np.where(index < steps, interval, 1.0), counted, np.ones((1, rows)), source.session,
            start)  # fmt: skip


def most_rows(simulator: StepModel | Engine) -> int:
    """Rows at most that are searched, and from which forecasts start."""
    return MOST_OF_ENGINE if is_engine(simulator) else MOST


def thinning(recordings: Sequence[Recording], most: int) -> int:
    """The least number k such that every k-th row makes at most `most`."""
    return -(-sum(len(r.time_s) for r in recordings) // most)


def filled(count: int) -> int:
    """The number to which `count` segments are padded."""
    if count <= FEWEST:
        return FEWEST
    step = max(FEW, 2 ** (count.bit_length() - 1) // SIZES)
    return -(-count // step) * step


def as_chunks(parts: Sequence[tuple]) -> Chunks:
    """Segments from their fields, one tuple per segment."""
    *arrays, session, row = (np.stack(a) for a in zip(*parts, strict=True))
    as_float = [jnp.asarray(a if a.dtype == bool else np.asarray(a, np.float32)) for a in arrays]
    return Chunks(*as_float, session=session, row=row)


def bare(chunks: Chunks) -> Chunks:
    """Segments without session and row, which are not JAX arrays, for `vmap` over segments."""
    zeros = jnp.zeros(len(chunks.state))
    return chunks._replace(session=zeros, row=zeros)


def until_last(scored: Bool[np.ndarray, "C t"]) -> Bool[np.ndarray, "C t"]:
    """Rows up to the last scored one of each segment."""
    return np.logical_or.accumulate(scored[:, ::-1], axis=1)[:, ::-1]


def counted(chunks: Chunks, e: np.ndarray) -> np.ndarray:
    """The scored rows of e, in order: [..., n, s]."""
    e = np.asarray(e)
    rows = e.reshape(*e.shape[:-3], e.shape[-3] * e.shape[-2], e.shape[-1])
    return rows.take(np.flatnonzero(np.asarray(chunks.counts)), axis=-2)  # a fifth of the time of a Boolean index


class Rows(NamedTuple):
    """Session and time [s] of every scored row, in order; the time is that at which the step to the row begins."""

    session: np.ndarray
    time_s: np.ndarray


def rows_of(chunks: Chunks) -> Rows:
    """Session and time of the scored rows."""
    counts = np.asarray(chunks.counts)
    session = np.broadcast_to(np.asarray(chunks.session)[:, None], counts.shape)[counts]
    return Rows(session, np.asarray(chunks.time_s)[:, :-1][counts])
