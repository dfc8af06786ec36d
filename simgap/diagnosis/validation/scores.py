"""Does it help? Errors on sessions that took no part, for the simulator as it is, refitted, augmented, and a black box.

Intervals are a bootstrap over pieces of the held-out sessions (whole sessions where there are five or more).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from simgap.diagnosis.config import LEAST_SESSIONS, LEAST_SHARE, LEVEL, MARGIN
from simgap.diagnosis.likelihood.problem import Problem
from simgap.diagnosis.likelihood.segments import RUN_IN, Chunks
from simgap.diagnosis.likelihood.student_t import Noise, fit_noise, log_density
from simgap.diagnosis.validation.bootstrap import Draws, averages, averages_known, interval, resample
from simgap.diagnosis.validation.forecast import Contestant, forecast, windows
from simgap.kinematics import wrapped
from simgap.layout import Layout, X, Y, Z
from simgap.rows import by_row
from simgap.types import Recording

HORIZONS = (1, 10, 50)
LEAST_ROWS = RUN_IN + max(HORIZONS) + 1
"""Rows of the shortest session that can be judged at all horizons."""
STRIDE = 5
RUN = 10
"""Pieces of one run, where sessions are too few to be the units; at least, see `_unit`."""


class Judged(NamedTuple):
    """Per piece of recording (n pieces): squared errors at the horizons, and one-step log-likelihood in nats a row.

    error: measured less predicted [n, horizons, s]. nll: [n]. moved: measured change over the horizon [n, horizons, s].
    session: of each piece.
    """

    error: Float[np.ndarray, "n h s"]
    moved: Float[np.ndarray, "n h s"]
    nll: Float[np.ndarray, " n"]
    session: np.ndarray


class Judgement(NamedTuple):
    """Every contestant on held-out sessions, and on those it was fitted to; empty where these are too short.

    lacking: of each effect found, the model that lacks it, on both.
    """

    heldout: dict[str, Judged]
    fitted: dict[str, Judged]
    refitted_without: tuple[tuple[Judged, Judged], ...]


def judge(problem: Problem, contestant: Contestant, fitted: Chunks, heldout: Chunks) -> tuple[Judged, Judged]:
    """A contestant on pieces of held-out sessions and of those it was fitted to, whose rows give its one-step noise."""
    missed = _missed(problem, contestant, fitted)
    e = missed.error[:, 0] @ problem.whiten.T
    finite = np.isfinite(e).all(1)
    noise = fit_noise(e[finite]) if finite.any() else None
    unseen = _missed(problem, contestant, heldout)
    return _scored(problem, unseen, noise), _scored(problem, missed, noise)


def _missed(problem: Problem, contestant: Contestant, pieces: Chunks) -> Judged:
    """What forecasts miss; their likelihood is still open."""
    layout = problem.augmented.layout
    predicted, measured = forecast(problem, contestant, pieces), _measured(pieces)
    steps = [h - 1 for h in HORIZONS if h <= measured.shape[1]]
    outputs = layout.observed
    error = by_row(wrapped, layout, measured[:, steps] - predicted[:, steps])[..., outputs]
    start = np.asarray(pieces.state)[:, -measured.shape[1] - 1]
    moved = by_row(wrapped, layout, measured[:, steps] - start[:, None])[..., outputs]
    return Judged(error, moved, np.full(len(error), np.nan), pieces.session)


def _scored(problem: Problem, missed: Judged, noise: Noise | None) -> Judged:
    """With the negative log-likelihood of one step; none was finite where there is no noise."""
    if noise is None:
        return missed
    e = missed.error[:, 0] @ problem.whiten.T
    return missed._replace(nll=-log_density(e, noise).sum(1) - np.linalg.slogdet(problem.whiten)[1])


def _measured(pieces: Chunks) -> np.ndarray:
    """Measured states after the run-in."""
    return np.asarray(pieces.state)[:, RUN_IN + 1 :]


def scores(layout: Layout, judged: Judged, rng: np.random.Generator) -> dict[str, dict[str, Any]]:
    """Held-out scores with 95 % intervals: nll_1, error_h (a share of the motion over h steps), metres per body."""
    draws = resample(_unit(judged.session), rng)
    table = {"nll_1": interval(averages_known(judged.nll, draws))}
    for k in range(judged.error.shape[1]):
        table[f"error_{HORIZONS[k]}"] = interval(_share_missed(judged, k, draws))
    last = judged.error.shape[1] - 1
    for b, body in enumerate(layout.bodies):
        axes = [int(i) for i in layout.position[b, [X, Y, Z]] if i >= 0]
        if axes:
            # Mean distance between predicted and measured position.
            distance = np.linalg.norm(judged.error[:, last][:, axes], axis=-1)
            table[f"error_{HORIZONS[last]}_{body} [m]"] = interval(averages(distance[:, None], draws)[:, 0])
    return table


def _share_missed(
    judged: Judged, k: int, draws: Draws | None = None, outputs: Sequence[int] | None = None
) -> Float[np.ndarray, " draws"]:
    """Root mean square over outputs of (RMS error / RMS motion); 1 is no better than standing still.

    The errors of all pieces, or of draws of them, by the motion of all. Infinite where a forecast exploded.
    """
    chosen = slice(None) if outputs is None else list(outputs)
    draws = np.ones((1, len(judged.session))) if draws is None else draws
    with np.errstate(over="ignore"):
        error = averages(judged.error[:, k][:, chosen] ** 2, draws)
    moved = np.maximum((judged.moved[:, k][:, chosen] ** 2).mean(0), 1e-12)
    return np.sqrt((error / moved).mean(1))


def _unit(session: np.ndarray, horizon: int = 1) -> np.ndarray:
    """What varies by itself: a number for each piece's session, or for its run of pieces where sessions are few.

    Runs are long enough that those next to each other share less than half of the rows that they forecast.
    """
    if len(np.unique(session)) >= LEAST_SESSIONS:
        return session
    return session * 10**6 + np.arange(len(session)) // max(RUN, -(-2 * horizon // STRIDE))


def difference(a: Judged, b: Judged, rng: np.random.Generator) -> dict[str, Any]:
    """Mean of a's nll less b's [nats a row], paired, with its interval: above zero where b is better."""
    return interval(averages_known(a.nll - b.nll, resample(_unit(a.session), rng)))


def horizons(judged: Judged) -> tuple[int, ...]:
    """The horizons [rows] that the pieces are long enough for."""
    return HORIZONS[: judged.error.shape[1]]


def changes(a: Judged, b: Judged, rng: np.random.Generator, outputs: Sequence[int] | None = None) -> list[dict]:
    """By which share of a's error b's differs at each horizon, with its interval, paired: below zero where b is better.

    Over all outputs, or some of them (indices).
    """
    draws = resample(_unit(a.session), rng)

    def more(k: int) -> Float[np.ndarray, " draws"]:
        before, after = (_share_missed(j, k, draws, outputs) for j in (a, b))
        exploded = np.where(np.isinf(after), 0.0, -1.0)
        with np.errstate(invalid="ignore"):
            return np.where(np.isinf(before), exploded, after / np.maximum(before, 1e-12) - 1)

    return [interval(more(k)) for k in range(a.error.shape[1])]


def worse_at(a: Judged, b: Judged, rng: np.random.Generator) -> list[int]:
    """The horizons [rows] at which b, by `MARGIN` and beyond chance, misses more of the motion than a."""
    return [h for h, c in zip(horizons(a), changes(a, b, rng), strict=True) if c["ci95"][0] > MARGIN]


def dearer_at(a: Judged, b: Judged) -> set[int]:
    """The horizons [rows] at which b misses more of the motion than a by `LEAST_SHARE`, by chance or not."""
    missed = ([_share_missed(j, k)[0] for j in (a, b)] for k in range(a.error.shape[1]))
    return {h for h, (before, after) in zip(horizons(a), missed, strict=True) if after > (1 + LEAST_SHARE) * before}


def explodes(a: Judged, b: Judged) -> bool:
    """Whether forecasts leave the finite numbers with b, and not with a."""
    shares = ([_share_missed(j, k)[0] for k in range(a.error.shape[1])] for j in (a, b))
    return any(np.isfinite(x) and not np.isfinite(y) for x, y in zip(*shares, strict=True))


def beats(references: Sequence[Judged], box: Judged) -> list[int]:
    """The horizons [rows] at which a black box surely misses less of the motion than each of the references does.

    By Student's t over sessions or runs of pieces; the chance of any horizon by noise alone is `LEVEL`.
    """
    level = LEVEL / len(horizons(box))
    return [h for k, h in enumerate(horizons(box)) if all(_misses_less(r, box, k, level) for r in references)]


def _misses_less(a: Judged, b: Judged, k: int, level: float) -> bool:
    if not _share_missed(b, k)[0] < (1 - MARGIN) * _share_missed(a, k)[0]:
        return False
    moved = np.maximum((a.moved[:, k] ** 2).mean(0), 1e-12)
    with np.errstate(over="ignore"):  # a forecast that exploded
        gains = ((a.error[:, k] ** 2 - b.error[:, k] ** 2) / moved).mean(1)
    return _surely_positive(gains, _unit(a.session, HORIZONS[k]), level)


def surely_likelier(a: Judged, b: Judged) -> bool:
    """Whether b has the lesser nll by more than noise gives with the chance at which it may pass for an effect."""
    return _surely_positive(a.nll - b.nll, _unit(a.session), LEVEL)


def _surely_positive(gains: Float[np.ndarray, " n"], unit: np.ndarray, level: float) -> bool:
    """Whether pieces gain on average, by Student's t over units, of which there may be too few for a bootstrap."""
    unit = np.unique(unit, return_inverse=True)[1]
    means = np.bincount(unit, gains) / np.bincount(unit)
    if len(means) < 2 or not np.isfinite(means).all():
        return False
    error = means.std(ddof=1) / np.sqrt(len(means))
    return bool(means.mean() > stdtrit(len(means) - 1, 1 - level) * error)


def explained_share(refitted: Judged, named: Judged, box: Judged, rng: np.random.Generator) -> dict[str, Any] | None:
    """Share of the black box's one-step gain that named physics makes; None where the box gains nothing sure."""
    if not surely_likelier(refitted, box):
        return None

    draws = resample(_unit(refitted.session), rng)
    named_gains, box_gains = (averages((refitted.nll - j.nll)[:, None], draws)[:, 0] for j in (named, box))
    # Physics can be better than the box; then it explains all there is to explain.
    return interval(np.clip(named_gains / np.maximum(box_gains, 1e-9), 0.0, 1.0))


def pieces_of(recordings: Sequence[Recording], time_step: float) -> Chunks | None:
    """Pieces for judging, with the longest horizon that at least one session allows."""
    for horizon in sorted(HORIZONS, reverse=True):
        found = windows(recordings, time_step, horizon, STRIDE)
        if found is not None:
            return found
    return None
