"""Scores on held-out sessions: of the simulator as it is, refitted, and augmented, and of a black box.

Intervals are a bootstrap over sessions if there are five or more, else over runs of pieces.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from simgap.diagnosis.config import LEAST_SESSIONS, LEAST_SHARE, LEVEL, MARGIN
from simgap.diagnosis.likelihood.problem import Problem
from simgap.diagnosis.likelihood.segments import RUN_IN, Chunks, most_rows, thinning
from simgap.diagnosis.likelihood.student_t import Noise, fit_noise, log_density
from simgap.diagnosis.validation.bootstrap import Draws, averages, averages_known, interval, resample
from simgap.diagnosis.validation.forecast import Contestant, forecast, windows
from simgap.engines import Engine
from simgap.kinematics import wrapped
from simgap.layout import Layout, X, Y, Z
from simgap.rows import by_row
from simgap.types import Recording, StepModel

HORIZONS = (1, 10, 50)
LEAST_ROWS = RUN_IN + max(HORIZONS) + 1
"""Minimum rows of a session that can be scored at all horizons."""
STRIDE = 5
"""Rows from the start of one piece to that of the next; a multiple of it where there are more than `most_rows`."""
RUN = 10
"""Minimum pieces of a run; runs are the bootstrap's units where sessions are few (see `_unit`)."""


class Judged(NamedTuple):
    """Errors of a model, piece by piece (n pieces).

    error: measured minus predicted [n, horizons, s]. moved: measured change over the horizon [n, horizons, s].
    nll: one-step negative log-likelihood [nats a row] [n]. session: of each piece.
    """

    error: Float[np.ndarray, "n h s"]
    moved: Float[np.ndarray, "n h s"]
    nll: Float[np.ndarray, " n"]
    session: np.ndarray


class Judgement(NamedTuple):
    """Every contestant on held-out sessions and on the fitted ones; empty if these are too short.

    refitted_without: for each effect found, the model without it, on both.
    """

    heldout: dict[str, Judged]
    fitted: dict[str, Judged]
    refitted_without: tuple[tuple[Judged, Judged], ...]


def judge(problem: Problem, contestant: Contestant, fitted: Chunks, heldout: Chunks) -> tuple[Judged, Judged]:
    """A contestant on held-out and on fitted pieces. Its one-step noise is estimated on the fitted ones."""
    on_fitted = _errors(problem, contestant, fitted)
    e = on_fitted.error[:, 0] @ problem.whiten.T
    finite = np.isfinite(e).all(1)
    noise = fit_noise(e[finite]) if finite.any() else None
    on_heldout = _errors(problem, contestant, heldout)
    return _scored(problem, on_heldout, noise), _scored(problem, on_fitted, noise)


def _errors(problem: Problem, contestant: Contestant, pieces: Chunks) -> Judged:
    """Forecast errors; the likelihood is still nan."""
    layout = problem.augmented.layout
    predicted, measured = forecast(problem, contestant, pieces), _measured(pieces)
    steps = [h - 1 for h in HORIZONS if h <= measured.shape[1]]
    outputs = layout.observed
    error = by_row(wrapped, layout, measured[:, steps] - predicted[:, steps])[..., outputs]
    start = np.asarray(pieces.state)[:, -measured.shape[1] - 1]
    moved = by_row(wrapped, layout, measured[:, steps] - start[:, None])[..., outputs]
    return Judged(error, moved, np.full(len(error), np.nan), pieces.session)


def _scored(problem: Problem, judged: Judged, noise: Noise | None) -> Judged:
    """With the one-step negative log-likelihood. `noise` is None if no error was finite."""
    if noise is None:
        return judged
    e = judged.error[:, 0] @ problem.whiten.T
    return judged._replace(nll=-log_density(e, noise).sum(1) - np.linalg.slogdet(problem.whiten)[1])


def _measured(pieces: Chunks) -> np.ndarray:
    """Measured states after the run-in."""
    return np.asarray(pieces.state)[:, RUN_IN + 1 :]


def scores(layout: Layout, judged: Judged, rng: np.random.Generator) -> dict[str, dict[str, Any]]:
    """Scores with 95 % intervals: nll_1, error_h (share of the motion over h steps), position error of every body."""
    draws = resample(_unit(judged.session), rng)
    table = {"nll_1": interval(averages_known(judged.nll, draws))}
    for k in range(judged.error.shape[1]):
        table[f"error_{HORIZONS[k]}"] = interval(relative_error(judged, k, draws))
    last = judged.error.shape[1] - 1
    for b, body in enumerate(layout.bodies):
        axes = [int(i) for i in layout.position[b, [X, Y, Z]] if i >= 0 and layout.observed[i]]
        if axes:
            # Mean distance between predicted and measured position.
            distance = np.linalg.norm(judged.error[:, last][:, axes], axis=-1)
            table[f"error_{HORIZONS[last]}_{body} [m]"] = interval(averages(distance[:, None], draws)[:, 0])
    return table


def relative_error(
    judged: Judged, k: int, draws: Draws | None = None, outputs: Sequence[int] | None = None
) -> Float[np.ndarray, " draws"]:
    """Root mean square over outputs of (RMS error / RMS motion); 1 is no better than predicting no motion.

    `draws` apply to the errors only; the motion is that of all pieces. Infinite where a forecast diverged.
    """
    chosen = slice(None) if outputs is None else list(outputs)
    draws = np.ones((1, len(judged.session))) if draws is None else draws
    with np.errstate(over="ignore"):
        error = averages(judged.error[:, k][:, chosen] ** 2, draws)
    moved = np.maximum((judged.moved[:, k][:, chosen] ** 2).mean(0), 1e-12)
    return np.sqrt((error / moved).mean(1))


def _unit(session: np.ndarray, horizon: int = 1) -> np.ndarray:
    """Independent units: the number of each piece's session or, where sessions are few, of its run of pieces.

    Runs are so long that neighbouring ones share less than half of the rows that they forecast.
    """
    if len(np.unique(session)) >= LEAST_SESSIONS:
        return session
    return session * 10**6 + np.arange(len(session)) // max(RUN, -(-2 * horizon // STRIDE))


def difference(a: Judged, b: Judged, rng: np.random.Generator) -> dict[str, Any]:
    """Mean of a's nll minus b's [nats a row], paired, with its interval: positive if b is better."""
    return interval(averages_known(a.nll - b.nll, resample(_unit(a.session), rng)))


def horizons(judged: Judged) -> tuple[int, ...]:
    """The horizons [rows] for which the pieces are long enough."""
    return HORIZONS[: judged.error.shape[1]]


def changes(a: Judged, b: Judged, rng: np.random.Generator, outputs: Sequence[int] | None = None) -> list[dict]:
    """Relative change of the error from a to b at each horizon, paired, with its interval: negative if b is better.

    outputs: indices of those compared; all by default.
    """
    draws = resample(_unit(a.session), rng)

    def change(k: int) -> Float[np.ndarray, " draws"]:
        before, after = (relative_error(j, k, draws, outputs) for j in (a, b))
        from_infinite = np.where(np.isinf(after), 0.0, -1.0)
        with np.errstate(invalid="ignore"):
            return np.where(np.isinf(before), from_infinite, after / np.maximum(before, 1e-12) - 1)

    return [interval(change(k)) for k in range(a.error.shape[1])]


def worse_at(a: Judged, b: Judged, rng: np.random.Generator) -> list[int]:
    """The horizons [rows] at which b's error exceeds a's by more than `MARGIN` over the whole 95 % interval."""
    return [h for h, c in zip(horizons(a), changes(a, b, rng), strict=True) if c["ci95"][0] > MARGIN]


def dearer_at(a: Judged, b: Judged) -> set[int]:
    """The horizons [rows] at which b's error exceeds a's by more than `LEAST_SHARE`, significantly or not."""
    errors = ([relative_error(j, k)[0] for j in (a, b)] for k in range(a.error.shape[1]))
    return {h for h, (before, after) in zip(horizons(a), errors, strict=True) if after > (1 + LEAST_SHARE) * before}


def explodes(a: Judged, b: Judged) -> bool:
    """Whether forecasts diverge with b at a horizon at which they do not with a."""
    errors = ([relative_error(j, k)[0] for k in range(a.error.shape[1])] for j in (a, b))
    return any(np.isfinite(x) and not np.isfinite(y) for x, y in zip(*errors, strict=True))


def beats(references: Sequence[Judged], box: Judged) -> list[int]:
    """The horizons [rows] at which a black box has a significantly smaller error than every reference.

    By one-sided t tests over sessions or runs of pieces, at `LEVEL` for all horizons together (Bonferroni).
    """
    level = LEVEL / len(horizons(box))
    return [h for k, h in enumerate(horizons(box)) if all(_significantly_smaller(r, box, k, level) for r in references)]


def _significantly_smaller(a: Judged, b: Judged, k: int, level: float) -> bool:
    """Whether b's error is smaller than a's at horizon `k` by more than `MARGIN`, and significantly so."""
    if not relative_error(b, k)[0] < (1 - MARGIN) * relative_error(a, k)[0]:
        return False
    moved = np.maximum((a.moved[:, k] ** 2).mean(0), 1e-12)
    with np.errstate(over="ignore"):  # a forecast that diverged
        gains = ((a.error[:, k] ** 2 - b.error[:, k] ** 2) / moved).mean(1)
    return _significantly_positive(gains, _unit(a.session, HORIZONS[k]), level)


def surely_likelier(a: Judged, b: Judged) -> bool:
    """Whether b has a significantly lower nll than a, at `LEVEL`."""
    return _significantly_positive(a.nll - b.nll, _unit(a.session), LEVEL)


def _significantly_positive(gains: Float[np.ndarray, " n"], unit: np.ndarray, level: float) -> bool:
    """One-sided t test for a positive mean over units, which may be too few for a bootstrap."""
    unit = np.unique(unit, return_inverse=True)[1]
    means = np.bincount(unit, gains) / np.bincount(unit)
    if len(means) < 2 or not np.isfinite(means).all():
        return False
    error = means.std(ddof=1) / np.sqrt(len(means))
    return bool(means.mean() > stdtrit(len(means) - 1, 1 - level) * error)


def explained_share(refitted: Judged, named: Judged, box: Judged, rng: np.random.Generator) -> dict[str, Any] | None:
    """Share of the black box's one-step gain that the named effects reach; None if its gain is not significant."""
    if not surely_likelier(refitted, box):
        return None

    draws = resample(_unit(refitted.session), rng)
    named_gains, box_gains = (averages((refitted.nll - j.nll)[:, None], draws)[:, 0] for j in (named, box))
    # The effects may gain more than the box; the share is then 1.
    return interval(np.clip(named_gains / np.maximum(box_gains, 1e-9), 0.0, 1.0))


def pieces_of(recordings: Sequence[Recording], simulator: StepModel | Engine) -> Chunks | None:
    """Pieces to score, with the longest horizon that at least one session allows; None if there is none."""
    stride = STRIDE * thinning(recordings, most_rows(simulator))
    for horizon in sorted(HORIZONS, reverse=True):
        pieces = windows(recordings, simulator.time_step, horizon, stride)
        if pieces is not None:
            return pieces
    return None
