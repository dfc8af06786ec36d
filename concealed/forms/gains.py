"""Gains of the command: too low, uneven, falling, and into another axis."""

from typing import Any

import numpy as np

from concealed.form import Array, Now, Size
from concealed.forms.channels import GROUPS, OnChannels, outputs_of
from concealed.operator import LIMIT
from concealed.plain import COMMAND, TIME_STEP


class Gain(OnChannels):
    """A constant fraction of the command."""

    id, scale = "gain", 0.6
    accept = ("viscous_drag",)
    why = "a drag in proportion to speed leaves a constant fraction of the command too; alpha takes up the rest"

    def __init__(self, rng: np.random.Generator, **given: Any) -> None:
        super().__init__(rng, **given)
        if self.on == (5,):
            self.accept = ("viscous_drag", "sensor_scale")
            self.why += "; a scaled ee_vz with another gamma is the same numbers"

    def follow(self, now: Now, c: int, u: Array) -> Array:
        return (1 - self.m) * u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("gain", 1 - magnitude, "-")


class AsymmetricGain(OnChannels):
    """One direction is followed less."""

    id, scale = "asymmetric_gain", 0.8

    def __init__(self, rng: np.random.Generator, **given: Any) -> None:
        super().__init__(rng, **given)
        self._weak = rng.choice([-1.0, 1.0])

    def follow(self, now: Now, c: int, u: Array) -> Array:
        return np.where(u * self._weak > 0, (1 - self.m) * u, u)

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("ratio", 1 - magnitude, "-")


class GainDrift(OnChannels):
    """A battery that sags: the gain falls evenly over a session, and a little more under load."""

    id, scale = "gain_drift", 2.5

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._used = np.zeros((size.batch, 6))

    def follow(self, now: Now, c: int, u: Array) -> Array:
        load = 0.8 + 0.8 * np.abs(u[0]) / LIMIT[c]
        self._used[:, c] += load * TIME_STEP / 60
        return np.clip(1 - self.m * self._used[:, c], 0.0, None) * u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("change per minute", -magnitude, "1/min")


class CrossAxis(OnChannels):
    """A command leaks into another axis of the same body."""

    id, scale = "cross_axis_coupling", 0.6

    def __init__(self, rng: np.random.Generator, **given: Any) -> None:
        super().__init__(rng, **given)
        self._into = int(rng.choice([c for c in GROUPS[self.on[0] // 3] if c != self.on[0]]))
        self._sign = rng.choice([-1.0, 1.0])
        self.outputs = outputs_of((self._into,))

    def command(self, now: Now, u: Array) -> Array:
        u = u.copy()
        u[:, :, self._into] += self._sign * self.m * u[:, :, self.on[0]]
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("ratio", self._sign * magnitude, "-")


class Misaligned(OnChannels):
    """Commands of a body are turned against its frame."""

    id, scale = "frame_misalignment", 0.6

    def __init__(self, rng: np.random.Generator, **given: Any) -> None:
        super().__init__(rng, groups=True, **given)
        self.on = self.on[:2]
        self.channels, self.outputs = tuple(COMMAND[c] for c in self.on), outputs_of(self.on)
        self._sign = rng.choice([-1.0, 1.0])

    def command(self, now: Now, u: Array) -> Array:
        i, j = self.on[0], self.on[1]
        c, s = np.cos(self._sign * self.m), np.sin(self._sign * self.m)
        u, x, y = u.copy(), u[:, :, i], u[:, :, j]
        u[:, :, i], u[:, :, j] = c * x - s * y, s * x + c * y
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("angle", self._sign * magnitude, "rad")
