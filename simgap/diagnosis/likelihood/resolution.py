"""Readings that come in steps, such as those of an encoder: their steps, and noise that hides these from the fits.

At rest such a reading repeats exactly. A likelihood with a noise scale would then be greatest for a model that never
moves: rows at rest would have no error at all, and all others would count as outliers. Uniform noise of one step, which
no reading contradicts, removes that [Uria, Murray & Larochelle 2013].
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from simgap.types import Recording, Sessions

ON_GRID, EXACT = 0.99, 0.01
"""Minimum share of the differences between rows that are multiples of a step, and how exactly, in steps."""
ROUNDING = float(np.finfo(np.float32).eps)
"""Steps below this share of the largest reading are rounding in 32 bits, in which filters run and many logs come."""
SIZES = 2
"""Minimum number of different multiples: a constant speed in a recording without noise is no step."""


def resolution(recordings: Sequence[Recording]) -> Float[np.ndarray, " s"]:
    """Step of every column of the state; zero for one that does not come in steps."""
    differences = np.concatenate([np.abs(np.diff(r.state.astype(np.float64), axis=0)) for r in recordings])
    largest = np.max([np.abs(r.state).max(0, initial=0.0) for r in recordings], axis=0)
    steps = np.array([_step(d) for d in differences.T])
    return np.where(steps > ROUNDING * largest, steps, 0.0)


def _step(differences: Float[np.ndarray, " n"]) -> float:
    """The size of which all differences are multiples; zero if there is none, or if no reading ever repeats."""
    moved = differences[differences > 0]
    if not len(moved) or len(moved) == len(differences):
        return 0.0
    sizes = np.unique(moved)
    gaps = np.diff(sizes)
    # Perhaps no difference is a single step. Gaps that are much smaller are rounding.
    step = min(sizes[0], gaps[gaps > EXACT * sizes[0]].min(initial=np.inf))
    multiples = moved / step
    nearest = np.round(multiples)
    on_grid = np.mean(np.abs(multiples - nearest) <= EXACT) >= ON_GRID
    return float(step) if on_grid and len(np.unique(nearest)) >= SIZES else 0.0


def dithered(sessions: Sessions, steps: Float[np.ndarray, " s"], rng: np.random.Generator) -> Sessions:
    """The sessions with uniform noise of one step in every reading that comes in steps."""

    def one(r: Recording) -> Recording:
        return r._replace(state=r.state + steps * rng.uniform(-0.5, 0.5, r.state.shape))

    if not steps.any():
        return sessions
    return sessions.each(one)
