"""Laws of sensors: what these show of the velocities is not what they are. Positions are read rightly."""

from collections.abc import Callable

import numpy as np

from simgap.ground.laws import Plain, Velocity


class Curve(Plain):
    """A curve that readings pass."""

    def __init__(self, curve: Callable[[Velocity], Velocity]) -> None:
        self.curve = curve

    def read(self, v: Velocity, row: float) -> Velocity:  # noqa: ARG002
        return self.curve(v)


class Offset(Plain):
    """Readings are off by `by`, of which a share wanders at random, over `lasts` [s]."""

    def __init__(self, by: float, share: float, lasts: float) -> None:
        self.by, self.share, self.lasts = by, share, lasts
        self.at: Velocity | None = None

    def read(self, v: Velocity, row: float) -> Velocity:
        kept = np.exp(-row / self.lasts)
        drawn = self.rng.standard_normal(v.shape)
        at = drawn if self.at is None else kept * self.at + np.sqrt(1 - kept**2) * drawn
        self.at = at
        return v + self.by * (1 + self.share * at)


class Old(Plain):
    """Readings are of `age` [s] ago, plus or minus some `jitter`."""

    def __init__(self, age: float, jitter: float) -> None:
        self.age, self.jitter = age, jitter
        self.were: list[Velocity] = []

    def read(self, v: Velocity, row: float) -> Velocity:
        self.were.append(v)
        ago = np.clip((self.age + self.jitter * self.rng.uniform(-1, 1)) / row, 0, len(self.were) - 1)
        newer, older = (self.were[len(self.were) - 1 - k] for k in (int(np.floor(ago)), int(np.ceil(ago))))
        return newer + (ago % 1) * (older - newer)
