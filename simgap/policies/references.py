"""Shapes for the hand to track [Hoffman et al. 2025, Shape Tracking]; their sizes and speeds are ours, it has none.

Both are given about the hand's place at the start, x ahead of the robot, y to its left, z up, in metres.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Ellipse:
    """semi_axes (x cos, y sin, z cos) [m], which tilts it where z is not 0; period [s] of a round; rounds [-]."""

    semi_axes: tuple[float, float, float]
    period: float
    rounds: float


@dataclass(frozen=True)
class Helix:
    """About an axis ahead of the robot: radius [m] in y and z, advance [m] along x a turn, period [s], turns [-]."""

    radius: float
    advance: float
    period: float
    turns: float


def ellipse(config: Ellipse, time_step: float) -> Float[np.ndarray, "T 3"]:
    """Goals one time step [s] apart about the ellipse's centre; the first lies ahead of it, not in it."""
    phase = _phase(config.period, config.rounds, time_step)
    return np.stack([np.cos(phase), np.sin(phase), np.cos(phase)], axis=1) * np.array(config.semi_axes)


def helix(config: Helix, time_step: float) -> Float[np.ndarray, "T 3"]:
    """Goals one time step [s] apart along the helix, whose axis begins in the centre; the first lies beside it."""
    phase = _phase(config.period, config.turns, time_step)
    turn = config.radius * np.stack([np.cos(phase), np.sin(phase)], axis=1)
    return np.column_stack([config.advance * phase / (2 * np.pi), turn])


def _phase(period: float, rounds: float, time_step: float) -> Float[np.ndarray, " T"]:
    return 2 * np.pi * np.arange(round(period * rounds / time_step)) * time_step / period
