"""What changed since a baseline: a difference between two sets of sessions, beyond that between sessions of one set."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int
from scipy.special import stdtrit

from simgap.diagnosis.config import LEAST_SESSIONS, LEVEL
from simgap.diagnosis.inference.model import Model, Trial
from simgap.diagnosis.inference.noise import noise_effects
from simgap.diagnosis.inference.noise_effect import NoiseEffect
from simgap.diagnosis.inference.posterior import differs_from_zero, spread
from simgap.diagnosis.inference.whiteness import Whiteness, by_row, whiteness
from simgap.diagnosis.likelihood.derivatives import nuisance_columns
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate
from simgap.diagnosis.likelihood.segments import Chunks, cut, rows_of
from simgap.types import Sessions


class _Units(NamedTuple):
    """What is independent: sessions, or chunks of few. starts: among the rows that count. sure: standard deviations
    that a difference between the two sets must have."""

    starts: Int[np.ndarray, " U"]
    sure: float


def differs(problem: Problem, tried: Trial, baseline: int) -> bool:
    """Whether an effect is another one since, however it varies from session to session before and after.

    What varies so, for physics that has no name or none yet, differs between any two sets of sessions.
    """
    units = _units(problem.chunks, baseline)
    sd = spread(problem, tried.fit, nuisance_columns(problem, tried.fit.v), units.starts)
    return differs_from_zero(problem, tried.fit, tried.hypothesis, sd, units.sure)


def _units(chunks: Chunks, baseline: int) -> _Units:
    """Of the two sets: the first so many sessions, and the others."""
    length, session = np.asarray(chunks.counts).sum(1), np.asarray(chunks.session)
    unit = np.where(length > 0, session, -1)
    if _fewest(unit, session < baseline) < LEAST_SESSIONS:
        unit = np.where(length > 0, np.arange(len(length)), -1)
    fewest = _fewest(unit, session < baseline)
    starts = np.flatnonzero(np.diff(np.repeat(unit, length), prepend=-1))
    return _Units(starts, float(stdtrit(max(fewest - 1, 1), 1 - LEVEL / 2)))


def _fewest(unit: Int[np.ndarray, " C"], before: Bool[np.ndarray, " C"]) -> int:
    """Number of units on the side that has fewer."""
    return min(len(np.unique(unit[side & (unit >= 0)])) for side in (before, ~before))


def whiteness_since(problem: Problem, fit: Fit, baseline: int) -> Whiteness:
    """What is left over, row for row, more than in the first so many sessions.

    A robot leaves a good deal over that no word of the vocabulary explains: no change, where it always has.
    """
    found, since = whiteness(problem, fit), rows_of(problem.chunks).session >= baseline
    gained, units = by_row(fit, found), _units(problem.chunks, baseline)

    def mean(rows: Bool[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Of some rows, with its variance over units."""
        mean = gained[rows].mean(0)
        about = np.where(rows[:, None], gained - mean, 0.0)
        return mean, (np.add.reduceat(about, units.starts) ** 2).sum(0) / rows.sum() ** 2

    (now, its), (before, theirs) = mean(since), mean(~since)
    more = now - before
    sure = more > units.sure * np.sqrt(its + theirs)
    part = np.where(sure, more / np.maximum(now, 1e-12), 0.0)
    return Whiteness(np.where(sure, more, 0.0) * since.sum(), part * found.share, part * found.predicted)


def whiteness_of(problem: Problem, fit: Fit, baseline: int) -> Whiteness:
    """What a fit leaves over, since the baseline of so many sessions where there is one."""
    return whiteness_since(problem, fit, baseline) if baseline else whiteness(problem, fit)


def noise_effects_since(model: Model, sessions: Sessions, unseen: Chunks) -> list[NoiseEffect]:
    """Effects on the scatter that the baseline does not have as well."""
    problem, fit, _ = model
    time_step, least = problem.augmented.simulator.time_step, len(problem.chunks.row)
    after, before = (cut(some, time_step, least) for some in (sessions.training, sessions.baseline))
    at = problem._replace(chunks=after)
    return noise_effects(at, evaluate(at, fit.v, fit.groups, fit.noise), unseen, before._replace(gate=0 * before.gate))
