"""How well a twin stands in for the robot: on sessions that took no part in its fit."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from simgap.recordings import HISTORY
from simgap.robots.twin import rows
from simgap.robots.twin.model import Twin
from simgap.robots.twin.windows import Windows, cut, errors, predict
from simgap.types import Recording

BODIES = {"base": slice(0, 2), "ee": slice(6, 9)}
LEVEL = 0.9
"""Probability of the interval whose coverage is counted."""


def multi_step(
    twin: Twin, recordings: Sequence[Recording], horizons: tuple[int, ...], stride: int, known: bool
) -> dict[str, float]:
    """Mean distance [m] between predicted and measured base and hand after `horizons` rows, as `scores.multi_step`.

    `known`: every row has the duration that its own measurements say; otherwise the mean of the recorded ones, as
    nobody can say beforehand which rows stall.
    """
    windows = _windows(twin, recordings, max(horizons), stride)
    if not known:
        windows = windows._replace(duration=jnp.full_like(windows.duration, twin.durations.mean()))
    wrong = np.asarray(_errors(twin, windows))[:, np.array(horizons) - 1]
    return {f"rollout_{name}_{h}": float(np.linalg.norm(wrong[:, i, axes], axis=-1).mean())
            for name, axes in BODIES.items() for i, h in enumerate(horizons)}  # fmt: skip


def coverage(
    key: PRNGKeyArray, twin: Twin, recordings: Sequence[Recording], horizon: int, stride: int, replays: int
) -> dict[str, float]:
    """Share of the measured positions of base and hand, an axis at a time, after `horizon` rows that lie in the central
    90 % of `replays` runs of the twin with the recorded commands and departures from other sessions."""
    windows = _windows(twin, recordings, horizon, stride)
    first = jax.random.randint(key, (replays, len(windows.duration), 1), 0, len(twin.durations))
    taken = (first + jnp.arange(horizon)) % len(twin.durations)
    ends = np.stack([np.asarray(_replayed(twin, windows, some)) for some in taken])
    low, high = np.quantile(ends, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
    inside = (low <= 0) & (high >= 0)
    return {f"coverage_{name}_{horizon}": float(inside[:, axes].mean()) for name, axes in BODIES.items()}


def _windows(twin: Twin, recordings: Sequence[Recording], horizon: int, stride: int) -> Windows:
    long = [r for r in recordings if len(r.state) > horizon + HISTORY]
    return cut([rows.timed(twin.model, r) for r in long], horizon, stride)


@jax.jit
def _errors(twin: Twin, windows: Windows) -> Float[Array, "n h 12"]:
    return errors(predict(twin.model, twin.ages, twin.reach, windows), windows)


@jax.jit
def _replayed(twin: Twin, windows: Windows, taken: Array) -> Float[Array, "n 12"]:
    """Errors at the windows' ends where rows `taken` of the recorded ones are replayed."""
    own = windows._replace(duration=twin.durations[taken])
    return errors(predict(twin.model, twin.ages, twin.reach, own, twin.missed[taken]), own)[:, -1]
