"""How a state was reached: the points where it turned, without what noise goes to and fro. For laws of hysteresis."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from simgap.diagnosis.likelihood.student_t import NORMAL_MAD

SHAKES = 5.0
"""Standard deviations of the noise within which a state counts as still: noise alone goes a long way to and fro."""
TURNED = 32
"""Points that are kept of each state."""


class Ways(NamedTuple):
    """The states of a session without noise to and fro, and the rows at which each turned."""

    moved: Float[np.ndarray, "T s"]
    turns: tuple[Int[np.ndarray, " k"], ...]


def noise_of(states: Sequence[Float[np.ndarray, "T s"]]) -> Float[np.ndarray, " s"]:
    """Standard deviation of the noise of each state in some sessions, by its second differences."""
    bends = np.concatenate([np.diff(state, 2, axis=0) for state in states])
    return NORMAL_MAD * np.median(np.abs(bends), axis=0) / np.sqrt(6) if len(bends) else np.zeros(bends.shape[1])


def ways_of(state: Float[np.ndarray, "T s"]) -> Ways:
    """The ways of a session: each state rests until it is further away than noise takes it."""
    width = SHAKES / 2 * noise_of([state])
    low, high, moved = state - width, state + width, np.array(state)
    for t in range(1, len(state)):
        moved[t] = np.minimum(np.maximum(moved[t - 1], low[t]), high[t])
    return Ways(moved, tuple(map(_turns, moved.T)))


def _turns(x: Float[np.ndarray, " T"]) -> Int[np.ndarray, " k"]:
    (changing,) = np.diff(x).nonzero()
    side = np.sign(x[changing + 1] - x[changing])
    return changing[1:][side[1:] != side[:-1]]


def reached(ways: Ways, row: int) -> Float[np.ndarray, "m s"]:
    """Where each state was before a row and where it turned before that, latest first; the oldest is repeated."""
    last = max(row - 1, 0)
    points = np.tile(ways.moved[0], (TURNED, 1))
    points[0] = ways.moved[last]
    for x, turns, to in zip(ways.moved.T, ways.turns, points.T, strict=True):
        before = turns[: np.searchsorted(turns, last)][:-TURNED:-1]
        to[1 : 1 + len(before)] = x[before]
    return points
