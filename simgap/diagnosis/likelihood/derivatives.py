"""Derivatives of the innovations by parameters, filter gain and effects' constants."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from simgap.diagnosis.likelihood.directions import bounds_of, directions, room_to_move, step_from
from simgap.diagnosis.likelihood.filter import Variables, tangents
from simgap.diagnosis.likelihood.problem import Group, Problem, decorrelate, side_by_side, trials, value_of, with_value

BATCH = 16
"""Directions whose derivatives are computed side by side: one number, for each is compiled anew."""
FEW = 0
"""Effects at most for which the program of derivatives leaves out the others: that of one friction alone takes half as
long to compile as that of all laws, and a search tries many combinations."""
STEP = 0.02
"""Of a constant's size and scale: the step of its central differences."""
PHI_STEP = 1e-3
"""Of a parameter's range, and of the gain: the step where the derivative itself is not finite."""


def nuisance_columns(problem: Problem, v: Variables) -> Float[np.ndarray, "M n s"]:
    """Derivatives of the decorrelated innovations by phi (in ranges) and K.

    As differences where a derivative is not finite, as that of a root at zero; zero where these are not either.
    """
    free, _ = directions(problem, ())
    count, lean = len(free.phi), problem.augmented.lean(FEW, v.theta, v.delta)

    def batch(first: int) -> np.ndarray:
        # The last batch is filled up by repetition.
        index = np.minimum(np.arange(first, first + BATCH), count - 1)
        along = free.phi[index], free.gain[index], free.cross[index]
        raw = tangents(lean, problem.scales, v, along, problem.chunks)
        return decorrelate(problem, raw)[: count - first]

    columns = np.concatenate(side_by_side(batch, range(0, count, BATCH)))
    odd = np.flatnonzero(~_bounded(columns))
    return _without_odd(columns, odd, _differences(problem, v, odd)) if len(odd) else columns


def _bounded(columns: Float[np.ndarray, "M n s"]) -> Bool[np.ndarray, " M"]:
    """Whether columns are finite, and their squares as well."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.array([np.isfinite(np.vdot(c, c)) for c in columns], bool)


def _without_odd(columns: np.ndarray, odd: np.ndarray, others: np.ndarray) -> Float[np.ndarray, "M n s"]:
    """Columns with some replaced by others where those are bounded, and by zero where not."""
    columns[odd] = np.where(_bounded(others)[:, None, None], others, 0.0)
    return columns


def _differences(problem: Problem, v: Variables, which: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k n s"]:
    """Derivatives along some directions of phi and K as differences, within bounds."""
    size = len(directions(problem, ())[1])
    plus, minus = ([step_from(problem, v, (), d * np.eye(size)[k]) for k in which] for d in (PHI_STEP, -PHI_STEP))
    down, up = room_to_move(problem, v, ())
    width = np.minimum(up, PHI_STEP) - np.maximum(down, -PHI_STEP)
    return _slopes(trials(problem, [*plus, *minus]), width[which])


def _slopes(e: Float[np.ndarray, "2k n s"], width: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k n s"]:
    """Differences of the first and the second half, over their distances; zero where that is zero."""
    k, wide = len(width), np.where(width > 0, width, np.inf).astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        return (e[:k] - e[k:]) / wide[:, None, None]


def constant_columns(problem: Problem, v: Variables, groups: Sequence[Group]) -> Float[np.ndarray, "k n s"]:
    """Derivatives by constants (in scales) as central differences, wide enough to see over kinks; one-sided at a bound,
    and zero where the simulator leaves the finite numbers."""
    if not groups:
        return np.zeros((0, int(np.asarray(problem.chunks.counts).sum()), len(problem.whiten)), np.float32)
    plus, minus, width = [], [], []
    for group in groups:
        value = value_of(v, group)
        h = STEP * (abs(value) + group.scale)
        low, high = bounds_of(problem, v, group)
        ends = np.array([min(value + h, high), max(value - h, low)], np.float32)
        for target, to in zip((plus, minus), ends, strict=True):
            target.append(with_value(v, group, to))
        width.append(float(ends[0] - ends[1]) / group.scale)
    columns = _slopes(trials(problem, [*plus, *minus]), np.array(width))
    odd = np.flatnonzero(~_bounded(columns))
    return _without_odd(columns, odd, np.zeros_like(columns[odd])) if len(odd) else columns
