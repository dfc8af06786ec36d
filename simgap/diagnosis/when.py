"""When an effect acts: from a time on in every session, during a stretch of one session, or in a regime."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.diagnosis.fit import Fit, weights
from simgap.diagnosis.innovations import Chunks
from simgap.diagnosis.restricted import inside
from simgap.effects.regime import Regime, words
from simgap.layout import Layout

LENGTHS = (8, 12, 20, 32, 50, 80, 125, 200, 320, 500, 800)
"""Rows of the stretches that are tried; edges are refined afterwards."""
PUSH = 8
"""Rows of the shortest push."""
LASTING = 50
"""Rows of the shortest stretch in which a law of motion may hold and not elsewhere."""
EDGE = 0.025
"""Share of the longest session, or of the one at hand, at either end in which no effect is said to begin."""
FLIP = 4
"""Rows that share a sign in the bootstrap of stretches."""
DRAWS = 100
CORRELATED = 20
"""Rows whose scores may be dependent."""


class When(NamedTuple):
    """Session (index, None for all), time [s] since its start, and regime (None for all)."""

    session: int | None = None
    from_s: float = 0.0
    to_s: float = np.inf
    regime: Regime | None = None


def told(layout: Layout, when: When) -> str:
    """In short: `where reach > 0.9 m`, `from 3.2 s on`."""
    return f"where {words(layout, when.regime)}" if when.regime is not None else f"from {when.from_s:.1f} s on"


class Rows(NamedTuple):
    """Session and time [s] of every row that counts, in order."""

    session: np.ndarray
    time_s: np.ndarray


def rows_of(chunks: Chunks) -> Rows:
    """Session and time of the rows that count."""
    counts = np.asarray(chunks.counts)
    session = np.broadcast_to(np.asarray(chunks.session)[:, None], counts.shape)[counts]
    return Rows(session, np.asarray(chunks.time_s)[:, :-1][counts])


def gate(layout: Layout, chunks: Chunks, when: When | None) -> Float[Array, "C T"]:
    """1 where an effect acts, which in a regime is as measured."""
    time = np.asarray(chunks.time_s)
    if when is None:
        return jnp.ones(time.shape)
    acts = (time >= when.from_s) & (time < when.to_s)
    if when.session is not None:
        acts &= (np.asarray(chunks.session) == when.session)[:, None]
    if when.regime is not None:
        acts &= inside(layout, when.regime, chunks)
    return jnp.asarray(acts, jnp.float32)


def scores(
    fit: Fit, without: Float[np.ndarray, "n s"], with_it: Float[np.ndarray, "n s"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Score and information of every row for an effect between two sets of innovations: (S, P), gain S^2 / 2P."""
    w = weights(fit.e, fit.noise)
    d = with_it - without
    return -(w * without * d).sum(1), (w * d**2).sum(1)


def onset(rows: Rows, score: np.ndarray, power: np.ndarray, session: int | None = None) -> tuple[When, float]:
    """The best time from which an effect acts, in every session or in one, and what the restriction gains [nats].

    In one session it may act all the time.
    """
    throughout = _gain(score.sum(), power.sum())
    mine = np.full(len(score), True) if session is None else rows.session == session
    latest_first = np.flatnonzero(mine)[np.argsort(-rows.time_s[mine], kind="stable")]
    times = rows.time_s[latest_first]
    s, p = np.cumsum(score[latest_first]), np.cumsum(power[latest_first])
    more = 0.5 * s**2 / np.maximum(p, 1e-9) - throughout
    # With a row belong all of its time.
    possible = np.append(times[1:] < times[:-1], session is not None)
    inside = (times > EDGE * times[0]) & (times < (1 - EDGE) * times[0])
    possible[:-1] &= inside[:-1]
    more = np.where(possible, more, 0.0)
    best = int(more.argmax())
    return When(session, float(times[best]) if more[best] > 0 else 0.0, np.inf), float(more[best])


def stretch(rows: Rows, score: np.ndarray, power: np.ndarray, shortest: int) -> tuple[When, float]:
    """The best stretch of at least so many rows of one session, and its gain [nats]."""
    best, where = 0.0, (0, 0, 0)
    for s in np.unique(rows.session):
        mine = np.flatnonzero(rows.session == s)
        gain, start, length = _best_window(score[mine], power[mine], shortest)
        if gain > best:
            best, where = gain, (int(s), start, length)
    s, start, length = where
    mine = np.flatnonzero(rows.session == s)
    start, stop = _edges(score[mine], power[mine], start, start + length, shortest)
    time = rows.time_s[mine]
    step = np.median(np.diff(time)) if len(time) > 1 else 0.0
    gain = _gain(score[mine[start:stop]].sum(), power[mine[start:stop]].sum())
    return When(s, float(time[start]), float(time[stop - 1] + step)), float(gain)


def stretch_by_chance(
    rows: Rows, score: np.ndarray, power: np.ndarray, level: float, rng: np.random.Generator
) -> float:
    """Gain [nats] that the best stretch reaches by chance with probability `level`.

    The larger of two: what random signs give, extrapolated (the best stretch itself takes no part: if something
    happened there, it is not chance), and what independent stretches would give, which is ln(number / level).
    """
    when, _ = stretch(rows, score, power, PUSH)
    score = elsewhere(rows, when, score)
    best = []
    for _ in range(DRAWS):
        sign = np.repeat(rng.choice([-1.0, 1.0], len(score) // FLIP + 1), FLIP)[: len(score)]
        best.append(max(_best_window(score[m] * sign[m], power[m], PUSH)[0] for m in _sessions(rows)))
    # Gains of many stretches have an exponential tail: Gumbel, by its moments.
    scale = np.std(best) * np.sqrt(6) / np.pi
    drawn = np.mean(best) - 0.5772 * scale - scale * np.log(-np.log(1 - level))
    return float(max(drawn, np.log(len(score) * len(LENGTHS) / level)))


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


def edges_ci95(
    rows: Rows, when: When, score: Float[np.ndarray, " n"], power: Float[np.ndarray, " n"]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """95 % intervals [s] of the beginning and the end of a stretch of one session, by profile likelihood.

    What an edge loses against the best is below x with probability (1 - exp(-x))^2 where it is the true one, the effect
    being fitted anew [Hansen 2000, for thresholds]: it is no chi-squared, for an edge moves by whole rows. Scores that
    vary more than they should, over blocks of rows, count for less. Between two rows an edge may lie anywhere.
    """
    mine = np.flatnonzero(rows.session == when.session)
    time, score, power = rows.time_s[mine], score[mine], power[mine]
    step = float(np.median(np.diff(time)))
    start, stop = (int(np.searchsorted(time, t - step / 2)) for t in (when.from_s, when.to_s))
    acts = (np.arange(len(time)) >= start) & (np.arange(len(time)) < stop)
    amplitude = score[acts].sum() / max(power[acts].sum(), 1e-9)
    about = np.add.reduceat(score - np.where(acts, amplitude * power, 0.0), np.arange(0, len(time), CORRELATED))
    lost = -np.log(1 - np.sqrt(0.95)) * max(1.0, float((about**2).sum() / max(power.sum(), 1e-9)))
    s, p = np.concatenate([[0], np.cumsum(score)]), np.concatenate([[0], np.cumsum(power)])
    starts, stops = np.arange(stop), np.arange(start + 1, len(time) + 1)
    found = []
    for at, gain in (
        (starts, 0.5 * (s[stop] - s[starts]) ** 2 / np.maximum(p[stop] - p[starts], 1e-9)),
        (stops, 0.5 * (s[stops] - s[start]) ** 2 / np.maximum(p[stops] - p[start], 1e-9)),
    ):
        possible = at[gain > gain.max() - lost]
        edge = np.append(time, time[-1] + step)[possible]
        found.append((float(edge.min() - step / 2), float(edge.max() + step / 2)))
    return found[0], found[1]


def _sessions(rows: Rows) -> list[np.ndarray]:
    return [np.flatnonzero(rows.session == s) for s in np.unique(rows.session)]


def _gain(score: float, power: float) -> float:
    return 0.5 * score**2 / power if power > 1e-9 else 0.0


def _best_window(score: np.ndarray, power: np.ndarray, shortest: int) -> tuple[float, int, int]:
    s, p = np.concatenate([[0], np.cumsum(score)]), np.concatenate([[0], np.cumsum(power)])
    best = (0.0, 0, min(LENGTHS[0], len(score)))
    for length in (k for k in LENGTHS if shortest <= k <= len(score)):
        gain = 0.5 * (s[length:] - s[:-length]) ** 2 / np.maximum(p[length:] - p[:-length], 1e-9)
        k = int(gain.argmax())
        if gain[k] > best[0]:
            best = (float(gain[k]), k, length)
    return best


def _edges(score: np.ndarray, power: np.ndarray, start: int, stop: int, shortest: int) -> tuple[int, int]:
    """Move both edges to where the gain is greatest."""
    s, p = np.concatenate([[0], np.cumsum(score)]), np.concatenate([[0], np.cumsum(power)])
    for _ in range(3):
        starts = np.arange(0, max(stop - shortest, 0) + 1)
        start = int(starts[np.argmax((s[stop] - s[starts]) ** 2 / np.maximum(p[stop] - p[starts], 1e-9))])
        stops = np.arange(min(start + shortest, len(score)), len(score) + 1)
        stop = int(stops[np.argmax((s[stops] - s[start]) ** 2 / np.maximum(p[stops] - p[start], 1e-9))])
    return start, stop
