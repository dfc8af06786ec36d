"""Kinds of missing physics of coupled machines, most of which the vocabulary has no word for.

Most push an axis by what another one does. `other` is the axis before: of the first one, the last.
"""

from typing import Any

import numpy as np

from simgap.ground.coupled import COUPLED, FLYER, TWO_LINKS
from simgap.ground.family import Family, named
from simgap.ground.laws import Law, Plain, Push, Velocity

NAMES = tuple(m.name for m in COUPLED)
FORCED = (TWO_LINKS.name, FLYER.name)
"""Several forces drive these, and the vocabulary has no word for one that acts on another axis of them."""


def other(values: Any) -> Any:
    """Of every axis, what another one does."""
    return np.roll(values, 1)


class Waves(Plain):
    """A push that rises and falls with time."""

    def __init__(self, size: float, frequency: float) -> None:
        self.size, self.frequency = size, frequency

    def begin(self, rng: np.random.Generator) -> None:
        self.angle = rng.uniform(0, 2 * np.pi)

    def push(self, q: Any, v: Velocity, u: Any, h: float) -> Velocity:  # noqa: ARG002
        self.angle += h * self.frequency
        return np.full(len(v), self.size * np.sin(self.angle))


class Sloshing(Plain):
    """A load on a spring moves within each body, of which it is a share of the mass."""

    def __init__(self, share: float, frequency: float, damping: float) -> None:
        self.share, self.frequency, self.damping = share, frequency, damping
        self.behind: Any = 0.0
        self.speed: Any = None

    def push(self, q: Any, v: Velocity, u: Any, h: float) -> Velocity:  # noqa: ARG002
        own = v if self.speed is None else self.speed
        pull = self.frequency**2 * self.behind + 2 * self.damping * self.frequency * (v - own)
        self.behind = self.behind + h * (v - own)
        self.speed = own + h * pull
        return -self.share * pull


def _magnet(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """A place that attracts, or repels, what is near it."""
    where, wide, force = rng.uniform(-0.5, 0.5), rng.uniform(0.15, 0.5), 2 * rng.choice([-1, 1]) * size * rate

    def pull(q: Any, v: Any, u: Any) -> Any:  # noqa: ARG001
        away = (q[: len(v)] - where) / wide
        return -force * away * np.exp(0.5 - away**2 / 2)

    return Push(pull)


def _crosswise(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """A push by the speed of another axis, as lift is."""
    power, force = rng.uniform(0.7, 2), rng.choice([-1, 1]) * size * rate
    return Push(lambda q, v, u: force * np.sign(other(v)) * np.abs(other(v)) ** power)  # noqa: ARG005


def _skidding(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """Motion is braked while another axis moves."""
    power, force = rng.uniform(0.7, 1.5), 2 * size * rate
    return Push(lambda q, v, u: -force * np.abs(other(v)) ** power * v)  # noqa: ARG005


def _keel(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """A drag that grows with the speed of the whole, not of the axis."""
    power, force = rng.uniform(1, 2), size * rate
    return Push(lambda q, v, u: -force * np.linalg.norm(v) ** power * v)  # noqa: ARG005


def _shadow(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """A push that depends on where another axis is."""
    turns, phase, force = rng.uniform(1, 5), rng.uniform(0, 2 * np.pi), size * rate
    return Push(lambda q, v, u: force * np.sin(turns * other(q[: len(v)]) + phase))  # noqa: ARG005


def _spilling(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """The forces of the other axes pull at one."""
    force, waves = rng.choice([-1, 1]) * size * rate, rng.uniform(0, 1)
    return Push(lambda q, v, u: force * (1 + waves * np.cos(2 * q[: len(v)])) * (u.sum() - u))


def _waves(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:
    return Waves(size * rate, 2 * np.pi / (row * rng.uniform(10, 80)))


def _sloshing(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    return Sloshing(2 * size, 2 * np.pi / (row * rng.uniform(5, 30)), rng.uniform(0.05, 0.5))


def _resistance(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    power, force = rng.uniform(0.85, 1.15), size * rate
    return Push(lambda q, v, u: -force * np.sign(v) * np.abs(v) ** power)  # noqa: ARG005


CROSSED = {
    "magnet": Family(named(), _magnet, NAMES),
    "crosswise": Family(named(), _crosswise, NAMES),
    "skidding": Family(named(), _skidding, NAMES),
    "keel": Family(named(), _keel, NAMES),
    "shadow": Family(named(), _shadow, NAMES),
    "spilling": Family(named(), _spilling, FORCED),
    "waves": Family(named(), _waves, NAMES),
    "sloshing": Family(named(), _sloshing, NAMES),
    # The others have such a drag as a parameter.
    "resistance": Family(named("viscous_drag"), _resistance, (FLYER.name,)),
}
