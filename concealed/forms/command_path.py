"""What becomes of a command on its way: lost, late, held back, clipped, stepped, turned."""

from typing import Any

import numpy as np

from concealed.form import SUBSTEPS, Array, Form, Now, Size
from concealed.operator import LIMIT
from concealed.plain import COMMAND, TIME_STEP

UNITS = ("m/s", "m/s", "rad/s", "m/s", "m/s", "m/s")
OUTPUT_OF = ("base_vx", "base_vy", "base_wz", "ee_vx", "ee_vy", "ee_vz")
GROUPS = ((0, 1, 2), (3, 4, 5))
MEMORY = 12
"""Rows of commands that are remembered."""


def outputs_of(channels: tuple[int, ...]) -> tuple[str, ...]:
    """Velocities in the world frame that commands of the body frame move: x and y are turned into each other."""
    found = [OUTPUT_OF[c] for c in channels]
    for pair in ((0, 1), (3, 4)):
        if any(c in channels for c in pair):
            found += [OUTPUT_OF[c] for c in pair]
    return tuple(dict.fromkeys(found))


class OnChannels(Form):
    """A form that acts on some of the six commands."""

    def __init__(self, rng: np.random.Generator, groups: bool = False, channels: tuple[int, ...] | None = None) -> None:
        drawn = GROUPS[rng.integers(2)] if groups else (int(rng.integers(6)),)
        self.on: tuple[int, ...] = channels or drawn
        self.channels = tuple(COMMAND[c] for c in self.on)
        self.outputs = outputs_of(self.on)

    @property
    def unit(self) -> str:
        return UNITS[self.on[0]]

    def command(self, now: Now, u: Array) -> Array:
        u = u.copy()
        for c in self.on:
            u[:, :, c] = self.follow(now, c, u[:, :, c])
        return u

    def follow(self, now: Now, c: int, u: Array) -> Array:
        """What becomes of channel c over the substeps [K, B]."""
        return u

    def one(self, name: str, value: float, unit: str) -> list[dict[str, Any]]:
        return [{"name": name, "value": value, "unit": unit}]


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
