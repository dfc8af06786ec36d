"""Free variables of a fit: parameters, filter gain and effects' constants, with their units, bounds and prior."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.likelihood.problem import Group, Problem, replaced, value_of, with_value
from simgap.diagnosis.likelihood.variables import Variables

TRUST = (0.0, 1.0)
"""Bounds of K's diagonal: the share of an innovation by which the state estimate is corrected."""
CROSS = 3.0
"""Bound of K's off-diagonal entries, in units of the time step."""
PRIOR_PRECISION = 1.0
"""Prior precision of the simulator's parameters, in units of their ranges: one range is one standard deviation, so the
prior is weak."""


def directions(problem: Problem, groups: Sequence[Group]) -> tuple[Variables, Float[np.ndarray, " M"]]:
    """Unit directions of all free variables (phi in ranges, K, constants in scales), and their prior precision."""
    layout = problem.augmented.layout
    p, s, size = len(problem.augmented.simulator.parameters), len(layout.observed), len(problem.augmented.slots)
    c = len(layout.akin)
    m = p + s + c + len(groups)
    phi, gain, cross, theta = (np.zeros((m, n), np.float32) for n in (p, s, c, size))
    delta = np.zeros((m, problem.chunks.gate.shape[1], size), np.float32)
    phi[:p] = np.diag(spans(problem))
    gain[p : p + s] = np.eye(s)
    cross[p + s : p + s + c] = np.eye(c)
    for k, group in enumerate(groups):
        base = theta if group.support == 0 else delta[:, group.support - 1]
        base[p + s + c + k, list(group.entries)] = group.scale
    precision = [(p, PRIOR_PRECISION), (s, 0.1), (c, 1.0), (len(groups), 1e-8)]
    return Variables(phi, gain, cross, theta, delta), np.concatenate([np.full(n, value) for n, value in precision])


def spans(problem: Problem) -> Float[np.ndarray, " p"]:
    """Widths of the parameters' ranges, which are their units in fits and derivatives."""
    return np.array([q.high - q.low or 1.0 for q in problem.augmented.simulator.parameters])


def bounds_of(problem: Problem, v: Variables, group: Group) -> tuple[float, float]:
    """Bounds of a constant. In a support, they bound its sum with theta and are widened to include its value in v."""
    (low, high), value = _bounds(problem, v.theta, group), value_of(v, group)
    return (min(low, value), max(high, value)) if group.support else (low, high)


def _bounds(problem: Problem, theta: Float[np.ndarray, " P"], group: Group) -> tuple[float, float]:
    """Bounds of a constant. In a support, they keep its sum with theta, which acts everywhere, in bounds."""
    entries = list(group.entries)
    everywhere = np.asarray(theta)[entries] if group.support else 0.0
    low, high = (bound[entries] - everywhere for bound in problem.augmented.bounds)
    return float(low.max()), float(high.min())


def _ranges(problem: Problem) -> tuple[Any, Any]:
    """Lower and upper limits of the parameters."""
    low, high = problem.augmented.ranges if problem.ranges_hold else (-np.inf, np.inf)
    if problem.near is None:
        return low, high
    return np.maximum(low, problem.near - problem.reach), np.minimum(high, problem.near + problem.reach)


def room_to_move(
    problem: Problem, v: Variables, groups: Sequence[Group]
) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, " M"]]:
    """Largest steps from v along each free direction, down (at most 0) and up (at least 0)."""
    (low, high), units = _ranges(problem), spans(problem)
    down = [(low - v.phi) / units, TRUST[0] - v.gain, -CROSS - v.cross]
    up = [(high - v.phi) / units, TRUST[1] - v.gain, CROSS - v.cross]
    for group in groups:
        (least, most), value = bounds_of(problem, v, group), value_of(v, group)
        down.append(np.array([(least - value) / group.scale]))
        up.append(np.array([(most - value) / group.scale]))
    return np.minimum(np.concatenate(down), 0.0), np.maximum(np.concatenate(up), 0.0)


def step_from(problem: Problem, v: Variables, groups: Sequence[Group], delta: np.ndarray) -> Variables:
    """v + delta along the free directions, clipped to the bounds against rounding errors."""
    free, _ = directions(problem, groups)
    step = delta.astype(np.float32)
    moved = Variables(*(a + (step @ b.reshape(len(b), -1)).reshape(a.shape) for a, b in zip(v, free, strict=True)))
    low, high = problem.augmented.bounds
    entries = [i for g in groups if g.support == 0 for i in g.entries]
    theta = replaced(moved.theta, entries, np.clip(moved.theta[entries], low[entries], high[entries]))
    phi = np.clip(moved.phi, *_ranges(problem))
    moved = Variables(phi, np.clip(moved.gain, *TRUST), np.clip(moved.cross, -CROSS, CROSS), theta, moved.delta)
    for group in (g for g in groups if g.support):
        moved = with_value(moved, group, float(np.clip(value_of(moved, group), *_bounds(problem, theta, group))))
    return moved


def prior_offset(problem: Problem, v: Variables, groups: Sequence[Group]) -> np.ndarray:
    """Offset of v from the prior's centre, along the free directions."""
    parameters = problem.augmented.simulator.parameters
    middle = np.array([(p.low + p.high) / 2 for p in parameters])
    return np.concatenate(
        [
            (np.asarray(v.phi) - middle) / spans(problem),
            np.asarray(v.gain) - 0.5,
            np.asarray(v.cross),
            np.zeros(len(groups)),
        ]
    )
