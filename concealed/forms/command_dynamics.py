"""Commands that take effect later: delay, lag, rate limit, dropout."""

from typing import Any

import numpy as np

from concealed.form import SUBSTEPS, Array, Now, Size
from concealed.forms.channels import OnChannels
from concealed.plain import TIME_STEP

MEMORY = 12
"""Rows of commands that are remembered."""


class Delay(OnChannels):
    """Packets arrive after a transport time that is not the same for any two of them."""

    id, scale = "delay", 0.4
    jitter = 0.15

    def __init__(self, rng: np.random.Generator, **given: Any) -> None:
        super().__init__(rng, groups=True, **given)

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._late = size.tile(rng.uniform(-1, 1, (size.sessions, size.rows)) * self.jitter)
        self._sent = np.zeros((MEMORY, size.batch, 6))

    def command(self, now: Now, u: Array) -> Array:
        if now.t == 0:
            self._sent[:] = now.sent
        self._sent = np.roll(self._sent, 1, axis=0)
        self._sent[0] = now.sent
        u, each = u.copy(), np.arange(u.shape[1])
        rows = self.m * (1 + self._late[:, now.t]) / TIME_STEP
        for k in range(SUBSTEPS):
            back = np.clip(np.ceil(rows - (k + 0.5) / SUBSTEPS), 0, MEMORY - 1).astype(int)
            for c in self.on:
                u[k, :, c] = self._sent[back, each, c]
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("delay", magnitude, "s")


class Lag(OnChannels):
    """Two stages in a row, a slow one and a quick one, whose times add up to the time constant."""

    id, scale = "lag", 0.8

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._at = np.zeros((2, size.batch, 6))

    def follow(self, now: Now, c: int, u: Array) -> Array:
        out, step = np.empty_like(u), TIME_STEP / SUBSTEPS
        a, b = self._at[0, :, c], self._at[1, :, c]
        for k in range(SUBSTEPS):
            a = a + (u[k] - a) * -np.expm1(-step / np.maximum(0.85 * self.m, 1e-9))
            b = b + (a - b) * -np.expm1(-step / np.maximum(0.15 * self.m, 1e-9))
            out[k] = b
        self._at[0, :, c], self._at[1, :, c] = a, b
        return out

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("time constant", magnitude, "s")


class RateLimit(OnChannels):
    """A drive with a limit on its torque: the command is approached no faster."""

    id, scale = "rate_limit", 1.0
    slowest = 0.25

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._at = np.zeros((size.batch, 6))

    def follow(self, now: Now, c: int, u: Array) -> Array:
        out, at = np.empty_like(u), self._at[:, c]
        most = self.slowest / np.maximum(self.m, 1e-9) * TIME_STEP / SUBSTEPS
        for k in range(SUBSTEPS):
            at = at + np.clip(u[k] - at, -most, most)
            out[k] = at
        self._at[:, c] = at
        return out

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return self.one("limit", self.slowest / max(magnitude, 1e-9), f"{self.unit}²")


class Dropout(OnChannels):
    """Packets are lost for a while, as often as a Poisson process has it, and the last command is held."""

    id, scale = "dropout", 0.8
    shortest, longest = 0.5, 1.5
    """Of the mean length."""

    def __init__(self, rng: np.random.Generator, **given: Any) -> None:
        super().__init__(rng, groups=True, **given)
        self.rate = float(rng.uniform(2, 6))

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        shape = (size.sessions, size.rows)
        self._lost = size.tile((rng.uniform(0, 1, shape) < self.rate / 60 * TIME_STEP).astype(float))
        self._length = size.tile(rng.uniform(self.shortest, self.longest, shape))
        self._left, self._held = np.zeros(size.batch), np.zeros((size.batch, 6))

    def command(self, now: Now, u: Array) -> Array:
        self._left = np.where(self._lost[:, now.t] > 0, self.m * self._length[:, now.t], self._left)
        u = u.copy()
        for k in range(SUBSTEPS):
            lost = self._left > 0.5 * TIME_STEP / SUBSTEPS
            for c in self.on:
                u[k, :, c] = np.where(lost, self._held[:, c], u[k, :, c])
            self._left = self._left - TIME_STEP / SUBSTEPS
            self._held = np.where(lost[:, None], self._held, u[k])
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        mean = (self.shortest + self.longest) / 2 * magnitude
        return [{"name": "rate", "value": self.rate, "unit": "1/min"}, {"name": "length", "value": mean, "unit": "s"}]
