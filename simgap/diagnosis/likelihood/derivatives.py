"""Derivatives of the innovations with respect to parameters, filter gain and effects' constants."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from simgap.diagnosis.likelihood.directions import bounds_of, directions, room_to_move, spans, step_from
from simgap.diagnosis.likelihood.filter import filtered, tangents
from simgap.diagnosis.likelihood.problem import Group, Problem, decorrelate, replaced, trials, value_of, with_value
from simgap.diagnosis.likelihood.sent import fading_by_phi
from simgap.diagnosis.likelihood.variables import Variables
from simgap.threads import side_by_side

BATCH = 16
"""Directions differentiated at once. Fixed, because every other number would be compiled anew."""
FEW = 0
"""With at most this many effects, the program of derivatives omits the laws of all others. With one friction it
compiles in half the time that all laws take, but a search tries many combinations."""
SENT_STEP = 0.01
"""Step of the central differences for a parameter on which the commands that act depend, as a share of its range."""
STEP = 0.02
"""Step of the central differences for a constant, as a share of its size plus its scale."""
PHI_STEP = 1e-3
"""Step of the differences for a parameter (share of its range) or the gain, where the derivative is not finite."""


def nuisance_columns(problem: Problem, v: Variables) -> Float[np.ndarray, "M n s"]:
    """Derivatives of the decorrelated innovations with respect to phi (in ranges) and K.

    Uses finite differences where a derivative is not finite (a root at zero), and zero where these are not finite.
    """
    free, _ = directions(problem, ())
    count, lean = len(free.phi), problem.augmented.lean(FEW, v.theta, v.delta)
    sent = filtered(problem.augmented, problem.scales, v, problem.chunks, v.phi).sent

    def batch(first: int) -> np.ndarray:
        # Pad the last batch by repetition.
        index = np.minimum(np.arange(first, first + BATCH), count - 1)
        along = free.phi[index], free.gain[index], free.cross[index]
        raw = tangents(lean, problem.scales, v, along, problem.chunks, sent)
        return decorrelate(problem, raw)[: count - first]

    columns = np.concatenate(side_by_side(batch, range(0, count, BATCH)))
    moved, by_sent = _by_sent(problem, v)
    columns[moved] += by_sent
    invalid = np.flatnonzero(~_bounded(columns))
    return _replace_invalid(columns, invalid, _differences(problem, v, invalid)) if len(invalid) else columns


def _by_sent(problem: Problem, v: Variables) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k n s"]]:
    """Which entries of phi change the innovations through the commands that act, and derivatives (in ranges) by these.

    The commands depend on phi by how fast each is forgotten within a row, so smoothly that central differences are
    exact enough, and only where there are laws on their way.
    """
    augmented, h = problem.augmented, SENT_STEP * spans(problem)
    on = np.any([theta != 0 for theta in (v.theta, *v.delta)], axis=0)
    places = {augmented.catalogue[effect].place for effect in augmented.effect_of[on]}
    depends = (
        np.asarray(fading_by_phi(augmented, v)).any(0) if places & {"command", "filter"} else np.zeros(len(h), bool)
    )
    moved = np.flatnonzero(depends)

    def at(phi: Float[np.ndarray, " p"]) -> Float[np.ndarray, "n s"]:
        return decorrelate(problem, filtered(augmented, problem.scales, v, problem.chunks, phi).innovations)

    ends = [replaced(v.phi, [int(k)], v.phi[k] + sign * h[k]) for sign in (1, -1) for k in moved]
    shape = 2 * len(moved), int(np.asarray(problem.chunks.counts).sum()), len(problem.whiten)
    e = np.array(side_by_side(at, ends), np.float32).reshape(shape)
    return moved, _slopes(e, np.full(len(moved), 2 * SENT_STEP))


def _bounded(columns: Float[np.ndarray, "M n s"]) -> Bool[np.ndarray, " M"]:
    """Whether columns and their squares are finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.array([np.isfinite(np.vdot(c, c)) for c in columns], bool)


def _replace_invalid(columns: np.ndarray, invalid: np.ndarray, replacements: np.ndarray) -> Float[np.ndarray, "M n s"]:
    """Columns with the invalid ones replaced: by the replacement where it is bounded, else by zero."""
    columns[invalid] = np.where(_bounded(replacements)[:, None, None], replacements, 0.0)
    return columns


def _differences(problem: Problem, v: Variables, indices: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k n s"]:
    """Finite differences along some directions of phi and K, within bounds."""
    size = len(directions(problem, ())[1])
    plus, minus = ([step_from(problem, v, (), d * np.eye(size)[k]) for k in indices] for d in (PHI_STEP, -PHI_STEP))
    down, up = room_to_move(problem, v, ())
    width = np.minimum(up, PHI_STEP) - np.maximum(down, -PHI_STEP)
    return _slopes(trials(problem, [*plus, *minus]), width[indices])


def _slopes(e: Float[np.ndarray, "2k n s"], width: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k n s"]:
    """Differences between the first and the second half, divided by their width; zero where the width is zero."""
    k, divisor = len(width), np.where(width > 0, width, np.inf).astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        return (e[:k] - e[k:]) / divisor[:, None, None]


def constant_columns(problem: Problem, v: Variables, groups: Sequence[Group]) -> Float[np.ndarray, "k n s"]:
    """Derivatives with respect to constants (in scales), by central differences wide enough to bridge kinks.

    Differences are one-sided at a bound, and zero where the simulation is not finite.
    """
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
    invalid = np.flatnonzero(~_bounded(columns))
    return _replace_invalid(columns, invalid, np.zeros_like(columns[invalid])) if len(invalid) else columns
