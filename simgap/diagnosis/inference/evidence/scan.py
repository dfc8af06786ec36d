"""The onset, window or regime in which an effect gains most, from its row-wise scores."""

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import BLOCK, LEAST_ROWS_OF_REGIME, NO_ONSET, SHORTEST_PUSH, SILENT
from simgap.diagnosis.hypotheses.support import From, Window, elsewhere
from simgap.diagnosis.likelihood.problem import Fit
from simgap.diagnosis.likelihood.segments import Rows
from simgap.diagnosis.likelihood.student_t import weights
from simgap.effects.regime import EVERYWHERE, Regime

LENGTHS = (8, 12, 20, 32, 50, 80, 125, 200, 320, 500, 800)
"""Lengths [rows] of the windows that are tried; edges are refined afterwards."""
FLIP = 4
"""Rows that share a sign in the bootstrap of windows."""
DRAWS = 100
NO_INFORMATION = 1e-9
"""Information [nats] below this counts as zero."""


def scores(
    fit: Fit, without: Float[np.ndarray, "n s"], with_it: Float[np.ndarray, "n s"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Score and information of every row for an effect between two sets of innovations: (S, P), gain S^2 / 2P."""
    w = weights(fit.e, fit.noise)
    d = with_it - without
    return -(w * without * d).sum(1), (w * d**2).sum(1)


def onset(rows: Rows, score: np.ndarray, power: np.ndarray, session: int | None = None) -> tuple[From | Window, float]:
    """The best time from which an effect acts, in every session or in one, and the gain of the restriction [nats].

    In one session it may act from the start.
    """
    throughout = gain_of(score.sum(), power.sum())
    in_session = np.full(len(score), True) if session is None else rows.session == session
    latest_first = np.flatnonzero(in_session)[np.argsort(-rows.time_s[in_session], kind="stable")]
    times = rows.time_s[latest_first]
    s, p = np.cumsum(score[latest_first]), np.cumsum(power[latest_first])
    extra = gain_of(s, p) - throughout
    # Rows with equal times belong together.
    possible = np.append(times[1:] < times[:-1], session is not None)
    inside = (times > NO_ONSET * times[0]) & (times < (1 - NO_ONSET) * times[0])
    possible[:-1] &= inside[:-1]
    extra = np.where(possible, extra, 0.0)
    best = int(extra.argmax())
    from_s = float(times[best]) if extra[best] > 0 else 0.0
    return From(from_s) if session is None else Window(session, from_s, np.inf), float(extra[best])


def stretch(rows: Rows, score: np.ndarray, power: np.ndarray, shortest: int) -> tuple[Window, float]:
    """The best window of at least `shortest` rows of one session, and its gain [nats]."""
    best, where = 0.0, (0, 0, 0)
    for s in np.unique(rows.session):
        in_session = np.flatnonzero(rows.session == s)
        gain, start, length = _best_window(score[in_session], power[in_session], shortest)
        if gain > best:
            best, where = gain, (int(s), start, length)
    s, start, length = where
    in_session = np.flatnonzero(rows.session == s)
    start, stop = _edges(score[in_session], power[in_session], start, start + length, shortest)
    time = rows.time_s[in_session]
    step = np.median(np.diff(time)) if len(time) > 1 else 0.0
    gain = gain_of(score[in_session[start:stop]].sum(), power[in_session[start:stop]].sum())
    return Window(s, float(time[start]), float(time[stop - 1] + step)), float(gain)


def stretch_by_chance(
    rows: Rows, score: np.ndarray, power: np.ndarray, level: float, rng: np.random.Generator
) -> float:
    """Gain [nats] that the best window reaches by chance with probability `level`.

    The larger of two: the extrapolated gain with random signs, and that of independent windows, ln(number / level).
    Random signs leave out the best window itself: if something happened there, it is not chance.
    """
    window, _ = stretch(rows, score, power, SHORTEST_PUSH)
    score = elsewhere(rows, window, score)
    best = []
    for _ in range(DRAWS):
        sign = np.repeat(rng.choice([-1.0, 1.0], len(score) // FLIP + 1), FLIP)[: len(score)]
        best.append(max(_best_window(score[m] * sign[m], power[m], SHORTEST_PUSH)[0] for m in _sessions(rows)))
    # The best of many gains with exponential tails follows a Gumbel distribution, here fitted by its moments.
    scale = np.std(best) * np.sqrt(6) / np.pi
    drawn = np.mean(best) - 0.5772 * scale - scale * np.log(-np.log(1 - level))
    return float(max(drawn, np.log(len(score) * len(LENGTHS) / level)))


def edges_ci95(
    rows: Rows, window: Window, score: Float[np.ndarray, " n"], power: Float[np.ndarray, " n"]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """95 % intervals [s] of the beginning and the end of a window of one session, by profile likelihood.

    With the effect refitted, the true edge loses less than x against the best one with probability (1 - exp(-x))^2
    [Hansen 2000, for thresholds]. This is not chi-squared, because an edge moves by whole rows. Scores with excess
    variance over blocks of rows count for less. Between two rows an edge may lie anywhere.
    """
    in_session = np.flatnonzero(rows.session == window.session)
    time, score, power = rows.time_s[in_session], score[in_session], power[in_session]
    step = float(np.median(np.diff(time)))
    start, stop = (int(np.searchsorted(time, t - step / 2)) for t in (window.from_s, window.to_s))
    acts = (np.arange(len(time)) >= start) & (np.arange(len(time)) < stop)
    amplitude = score[acts].sum() / max(power[acts].sum(), 1e-9)
    about = np.add.reduceat(score - np.where(acts, amplitude * power, 0.0), np.arange(0, len(time), BLOCK))
    tolerance = -np.log(1 - np.sqrt(0.95)) * max(1.0, float((about**2).sum() / max(power.sum(), 1e-9)))
    s, p = np.concatenate([[0], np.cumsum(score)]), np.concatenate([[0], np.cumsum(power)])
    starts, stops = np.arange(stop), np.arange(start + 1, len(time) + 1)
    intervals = []
    for at, gain in (
        (starts, gain_of(s[stop] - s[starts], p[stop] - p[starts])),
        (stops, gain_of(s[stops] - s[start], p[stops] - p[start])),
    ):
        possible = at[gain > gain.max() - tolerance]
        edge = np.append(time, time[-1] + step)[possible]
        intervals.append((float(edge.min() - step / 2), float(edge.max() + step / 2)))
    return intervals[0], intervals[1]


def _sessions(rows: Rows) -> list[np.ndarray]:
    return [np.flatnonzero(rows.session == s) for s in np.unique(rows.session)]


def gain_of(score: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Gain [nats] with the best amplitude along a direction, S^2 / 2P; zero where there is no information."""
    return np.where(power > NO_INFORMATION, 0.5 * score**2 / np.maximum(power, NO_INFORMATION), 0.0)


def _best_window(score: np.ndarray, power: np.ndarray, shortest: int) -> tuple[float, int, int]:
    s, p = np.concatenate([[0], np.cumsum(score)]), np.concatenate([[0], np.cumsum(power)])
    best = (0.0, 0, min(LENGTHS[0], len(score)))
    for length in (k for k in LENGTHS if shortest <= k <= len(score)):
        gain = gain_of(s[length:] - s[:-length], p[length:] - p[:-length])
        k = int(gain.argmax())
        if gain[k] > best[0]:
            best = (float(gain[k]), k, length)
    return best


def _edges(score: np.ndarray, power: np.ndarray, start: int, stop: int, shortest: int) -> tuple[int, int]:
    """Move both edges to the greatest gain."""
    s, p = np.concatenate([[0], np.cumsum(score)]), np.concatenate([[0], np.cumsum(power)])
    for _ in range(3):
        starts = np.arange(0, max(stop - shortest, 0) + 1)
        start = int(starts[np.argmax((s[stop] - s[starts]) ** 2 / np.maximum(p[stop] - p[starts], 1e-9))])
        stops = np.arange(min(start + shortest, len(score)), len(score) + 1)
        stop = int(stops[np.argmax((s[stops] - s[start]) ** 2 / np.maximum(p[stops] - p[start], 1e-9))])
    return start, stop


def narrowest(
    found: Float[np.ndarray, "n f"], score: Float[np.ndarray, " n"], power: Float[np.ndarray, " n"], share: float
) -> tuple[Regime, float]:
    """The regime to which an effect is best restricted, and the gain of the restriction [nats]; everywhere, if none.

    `score` and `power` are those of every row (see `scores`). Outside, the effect must be silent: an effect of any
    other size may gain at most `SILENT` and `share` of the gain inside.
    """
    best, most = EVERYWHERE, 0.0
    throughout = gain_of(score.sum(), power.sum())
    for k, column in enumerate(found.T):
        order = np.argsort(column, kind="stable")
        s, p = (np.cumsum(a[order]) for a in (score, power))
        ordered, fewest = column[order], int(np.ceil(LEAST_ROWS_OF_REGIME * len(column)))
        # Rows after which an edge may lie; rows with equal values belong together.
        last = np.flatnonzero(ordered[:-1] < ordered[1:])
        last = last[(last + 1 >= fewest) & (last + 1 <= len(column) - fewest)]
        below, above = gain_of(s[last], p[last]), gain_of(s[-1] - s[last], p[-1] - p[last])
        for side, acting, silent in ((1.0, above, below), (-1.0, below, above)):
            extra = np.where(silent < SILENT + share * acting, acting - throughout, 0.0)
            if extra.max(initial=0.0) > most:
                i = int(extra.argmax())
                edge = float(ordered[last[i]] + ordered[last[i] + 1]) / 2
                best, most = Regime(k, side, edge), float(extra[i])
    return best, most
