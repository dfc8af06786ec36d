"""Hard nonlinearities of the command: saturation, deadband, backlash, quantization."""

from typing import Any

import numpy as np

from concealed.form import SUBSTEPS, Array, Now, Size
from concealed.forms.channels import OnChannels
from concealed.operator import LIMIT


class Saturation(OnChannels):
    """A hard clip."""

    id, scale = "saturation", 0.9

    def follow(self, now: Now, c: int, u: Array) -> Array:
        limit = (1 - self.m) * LIMIT[c]
        return np.clip(u, -limit, limit)

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("limit", (1 - magnitude) * LIMIT[self.on[0]], self.unit)


class Deadband(OnChannels):
    """Nothing happens below the width, and the rest is shifted by it."""

    id, scale = "deadband", 0.3

    def follow(self, now: Now, c: int, u: Array) -> Array:
        return np.sign(u) * np.maximum(np.abs(u) - self.m, 0.0)

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("width", magnitude, self.unit)


class Backlash(OnChannels):
    """Real play: what is driven stays where it is until the driver has crossed the gap."""

    id, scale = "backlash", 0.6

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._at = np.zeros((size.batch, 6))

    def follow(self, now: Now, c: int, u: Array) -> Array:
        out, at = np.empty_like(u), self._at[:, c]
        for k in range(SUBSTEPS):
            at = np.clip(at, u[k] - self.m / 2, u[k] + self.m / 2)
            out[k] = at
        self._at[:, c] = at
        return out

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("gap", magnitude, self.unit)


class Quantization(OnChannels):
    """Steps, with a comparator that has a hysteresis of a tenth of a step."""

    id, scale = "quantization", 0.5

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._at = np.zeros((size.batch, 6))

    def follow(self, now: Now, c: int, u: Array) -> Array:
        step, at = np.maximum(self.m, 1e-6), self._at[:, c]
        at = np.where(np.abs(u[0] - at) > 0.55 * step, np.round(u[0] / step) * step, at)
        self._at[:, c] = at
        return np.where(self.m > 0, np.repeat(at[None], len(u), axis=0), u)

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("step", magnitude, self.unit)
