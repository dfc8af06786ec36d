"""Changes since a baseline: differences between two sets of sessions, beyond those between sessions of one set."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int
from scipy.special import stdtrit

from simgap.diagnosis.config import LEAST_SESSIONS, LEVEL
from simgap.diagnosis.inference.fitting.model import Model, Trial
from simgap.diagnosis.inference.misfit.whiteness import Whiteness, by_row, whiteness
from simgap.diagnosis.inference.noise.effect import NoiseEffect
from simgap.diagnosis.inference.noise.find import noise_effects
from simgap.diagnosis.inference.search.posterior import differs_from_zero, spread
from simgap.diagnosis.likelihood.derivatives import nuisance_columns
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate
from simgap.diagnosis.likelihood.segments import Chunks, cut, most_rows, rows_of
from simgap.types import Sessions


class _Units(NamedTuple):
    """Independent units: sessions, or segments where there are few. starts: of units, among the rows that count. sure:
    standard deviations by which the two sets must differ."""

    starts: Int[np.ndarray, " U"]
    sure: float


def differs(problem: Problem, tried: Trial, baseline: int) -> bool:
    """Whether an effect changed since the baseline by more than it varies between sessions before and after.

    Physics that is unnamed, or not found yet, makes constants vary so; they then differ between any two sets.
    """
    units = _units(problem.chunks, baseline)
    sd = spread(problem, tried.fit, nuisance_columns(problem, tried.fit.v), units.starts)
    return differs_from_zero(problem, tried.fit, tried.hypothesis, sd, units.sure)


def _units(chunks: Chunks, baseline: int) -> _Units:
    """Units of the two sets: the first `baseline` sessions, and the others."""
    length, session = np.asarray(chunks.counts).sum(1), np.asarray(chunks.session)
    unit = np.where(length > 0, session, -1)
    if _fewest(unit, session < baseline) < LEAST_SESSIONS:
        unit = np.where(length > 0, np.arange(len(length)), -1)
    fewest = _fewest(unit, session < baseline)
    starts = np.flatnonzero(np.diff(np.repeat(unit, length), prepend=-1))
    return _Units(starts, float(stdtrit(max(fewest - 1, 1), 1 - LEVEL / 2)))


def _fewest(unit: Int[np.ndarray, " C"], before: Bool[np.ndarray, " C"]) -> int:
    """Number of units in the smaller set."""
    return min(len(np.unique(unit[side & (unit >= 0)])) for side in (before, ~before))


def whiteness_since(problem: Problem, fit: Fit, baseline: int) -> Whiteness:
    """What is predictable in the innovations, per row, beyond that in the first `baseline` sessions.

    A robot's innovations are always predictable to a degree that no effect of the vocabulary explains. That is no
    change.
    """
    overall, since = whiteness(problem, fit), rows_of(problem.chunks).session >= baseline
    gained, units = by_row(fit, overall), _units(problem.chunks, baseline)

    def mean(rows: Bool[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Mean over some rows, and its variance over units."""
        mean = gained[rows].mean(0)
        about = np.where(rows[:, None], gained - mean, 0.0)
        return mean, (np.add.reduceat(about, units.starts) ** 2).sum(0) / rows.sum() ** 2

    (now, its), (before, theirs) = mean(since), mean(~since)
    increase = now - before
    sure = increase > units.sure * np.sqrt(its + theirs)
    part = np.where(sure, increase / np.maximum(now, 1e-12), 0.0)
    return Whiteness(np.where(sure, increase, 0.0) * since.sum(), part * overall.share, part * overall.predicted)


def whiteness_of(problem: Problem, fit: Fit, baseline: int) -> Whiteness:
    """What is predictable in the innovations of a fit: since the baseline, if there is one."""
    return whiteness_since(problem, fit, baseline) if baseline else whiteness(problem, fit)


def noise_effects_since(model: Model, sessions: Sessions, unseen: Chunks) -> list[NoiseEffect]:
    """Effects on the noise that the baseline does not show."""
    problem, fit, _ = model
    simulator = problem.augmented.simulator
    size = simulator.time_step, len(problem.chunks.row), most_rows(simulator)
    after, before = (cut(recordings, *size) for recordings in (sessions.training, sessions.baseline))
    current = problem._replace(chunks=after)
    return noise_effects(
        current, evaluate(current, fit.v, fit.groups, fit.noise), unseen, before._replace(gate=0 * before.gate)
    )
