"""What is amiss with clocks and sensors: stalls, late and biased outputs, noise that is not even."""

from typing import Any

import numpy as np

from concealed.form import Array, Form, Now, Size
from concealed.plain import POSITION, STATE, TIME_STEP, VELOCITY

WORDS = {"base": (0, 1, 2, 3, 4, 5), "ee": (6, 7, 8, 9, 10, 11)}


class Stalls(Form):
    """The recorder hangs now and then: rows that span more time than their stamps say."""

    id, scale = "sampling_interval", 4.0
    share = 0.08
    outputs = tuple(STATE[i] for i in POSITION)

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        hangs = rng.uniform(size=(size.sessions, size.rows)) < self.share
        self._extra = size.tile(hangs * rng.uniform(0.6, 1.4, hangs.shape))

    def row(self, now: Now) -> None:
        now.duration = 1 + self.m * self._extra[:, now.t]

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "share of stalls", "value": self.share, "unit": "-"},
                {"name": "length of stalls", "value": (1 + magnitude) * TIME_STEP, "unit": "s"}]  # fmt: skip


class OldVelocity(Form):
    """Positions are stamped late: part of a row they went on by the velocity before."""

    id, scale = "integration_rule", 1.0
    outputs = tuple(STATE[i] for i in POSITION)

    def shift(self, now: Now, v: Array) -> Array:
        old = np.concatenate([now.x[:, 3:6], now.x[:, 9:12]], axis=1)
        return v + self.m[:, None] * (old - v)

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "weight", "value": magnitude, "unit": "-"}]


class Shaking(Form):
    """What is measured scatters more in motion."""

    id, scale = "motion_dependent_noise", 6.0

    def __init__(self, rng: np.random.Generator) -> None:
        self.body = str(rng.choice(["base", "ee"]))
        self.outputs = tuple(STATE[i] for i in WORDS[self.body])

    def scatter(self, t: int, true: Array, noise: Array) -> Array:
        noise = noise.copy()
        noise[:, WORDS[self.body]] *= self.growth(true[t])[:, None]
        return noise

    def growth(self, x: Array) -> Array:
        """Noise over noise at rest [B]."""
        return self.growth_at(x, self.m)

    def growth_at(self, x: Array, magnitude: Array | float) -> Array:
        """The same at a magnitude."""
        speed = np.linalg.norm(x[:, 3:5] if self.body == "base" else x[:, 9:12], axis=1)
        return 1 + magnitude * np.clip(speed / 0.5, 0.0, 1.5)

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "ratio", "value": 1 + magnitude, "unit": "-"}]


class LateSensor(Form):
    """A sensor with a clock of its own: some outputs are older than their stamp, by a time that trembles."""

    id, scale = "sensor_delay", 0.35
    jitter = 0.15

    def __init__(self, rng: np.random.Generator) -> None:
        kind = int(rng.integers(3))
        self._on = ((6, 7, 8), (9, 10, 11), (3, 4, 5))[kind]
        self.outputs = tuple(STATE[i] for i in self._on)

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._late = size.tile(1 + self.jitter * rng.uniform(-1, 1, (size.sessions, size.rows)))

    def sense(self, t: int, true: Array, seen: Array) -> Array:
        back = np.clip(self.m * self._late[:, t] / TIME_STEP, 0.0, t)
        whole = np.floor(back).astype(int)
        rest, each = (back - whole)[:, None], np.arange(len(back))
        new, old = true[t - whole, each], true[np.maximum(t - whole - 1, 0), each]
        seen = seen.copy()
        on = list(self._on)
        seen[:, on] = ((1 - rest) * new + rest * old)[:, on]
        return seen

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "delay", "value": magnitude, "unit": "s"}]


class Drifting(Form):
    """A velocity sensor whose zero warms up over a session."""

    id, scale = "sensor_bias", 0.4

    def __init__(self, rng: np.random.Generator) -> None:
        self._on = int(rng.choice(VELOCITY))
        self._sign = rng.choice([-1.0, 1.0])
        self.outputs = (STATE[self._on],)

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._rows = size.rows

    def sense(self, t: int, true: Array, seen: Array) -> Array:
        seen = seen.copy()
        seen[:, self._on] += self._sign * self.m * t / self._rows
        return seen


class TurnedCompass(Form):
    """The yaw is measured from another north than the hand's position is."""

    id, scale = "sensor_bias", 0.5
    outputs = ("base_yaw",)
    accept = ("frame_misalignment",)
    why = "with the yaw off by an angle, all commands are turned by it"

    def __init__(self, rng: np.random.Generator) -> None:
        self._sign = rng.choice([-1.0, 1.0])

    def sense(self, t: int, true: Array, seen: Array) -> Array:
        seen = seen.copy()
        seen[:, 2] += self._sign * self.m
        return seen

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "bias", "value": self._sign * magnitude, "unit": "rad"}]


class Scaled(Form):
    """A velocity sensor in the wrong unit."""

    id, scale = "sensor_scale", 0.5

    def __init__(self, rng: np.random.Generator) -> None:
        self._on = ((3, 4), (5,), (11,), (9, 10))[int(rng.integers(4))]
        self.outputs = tuple(STATE[i] for i in self._on)
        if self._on == (11,):
            self.accept = ("gain", "viscous_drag")
            self.why = "a vertical command that is followed by a fraction gives the same numbers, with another gamma"

    def sense(self, t: int, true: Array, seen: Array) -> Array:
        seen = seen.copy()
        for i in self._on:
            seen[:, i] *= 1 - self.m
        return seen

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "scale", "value": 1 - magnitude, "unit": "-"}]
