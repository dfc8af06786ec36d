"""Laws that no word of the vocabulary means."""

import numpy as np

from concealed.form import Array, Form, Now, Size
from concealed.operator import LIMIT
from concealed.plain import TIME_STEP, turned


class Attracted(Form):
    """A magnet in the room: within half a metre the hand is drawn to it."""

    scale, outputs = 3.0, ("ee_vx", "ee_vy")
    depends = ("ee_x", "ee_y")

    def __init__(self, rng: np.random.Generator) -> None:
        self._at = rng.uniform(-1, 1, 2) * 0.8 + np.array([0.6, 0.0])

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "ee":
            return u
        to = self._at - now.x[:, 6:8]
        pull = self.m[:, None] * to * np.exp(-((to**2).sum(1, keepdims=True)) / 0.25)
        return u + turned(-now.yaw, np.concatenate([pull, 0 * pull[:, :1]], axis=1))


class LiftTurns(Form):
    """Lifting the hand turns the base, with the square of the speed: a skewed gear."""

    scale, outputs = 8.0, ("base_wz",)
    depends = ("cmd_ee_vz",)

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        u = u.copy()
        u[:, 2] += self.m * now.sent[:, 5] ** 2
        return u


class Corrugated(Form):
    """A floor in waves: the base is thrown to and fro as it passes over them."""

    scale, outputs = 0.3, ("base_vx",)
    depends = ("base_x",)

    def __init__(self, rng: np.random.Generator) -> None:
        self._wave = rng.uniform(0.4, 0.9)

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        moving = np.clip(np.hypot(v[:, 0], v[:, 1]) / 0.2, 0.0, 1.0)
        push = self.m * moving * np.sin(2 * np.pi * now.x[:, 0] / self._wave)
        return u + turned(-now.yaw, np.stack([push, 0 * push, 0 * push], axis=1))


class WindUp(Form):
    """A spring that three seconds of walking wind up: the base turns back what it unwinds."""

    scale, outputs = 1.5, ("base_wz",)
    depends = ("cmd_base_vx",)

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._wound = np.zeros(size.batch)

    def row(self, now: Now) -> None:
        self._wound += (now.sent[:, 0] - self._wound / 3.0) * TIME_STEP

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        u = u.copy()
        u[:, 2] += self.m * self._wound
        return u


class Elastic(Form):
    """A springy arm: commands to the hand set it ringing, lightly damped."""

    scale, outputs = 1.0, ("ee_vx", "ee_vy")
    depends = ("its own past",)

    def __init__(self, rng: np.random.Generator) -> None:
        self._rate = 2 * np.pi * rng.uniform(1.2, 2.2)

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._q, self._dq, self._u = (np.zeros((size.batch, 2)) for _ in range(3))

    def blend(self, now: Now, part: str, old: Array, relaxed: Array) -> Array:
        if part != "ee":
            return relaxed
        was = self._dq.copy()
        self._dq += now.sent[:, 3:5] - self._u
        self._u = now.sent[:, 3:5].copy()
        for _ in range(8):
            self._dq += (-(self._rate**2) * self._q - 0.1 * self._rate * self._dq) * TIME_STEP / 8
            self._q += self._dq * TIME_STEP / 8
        ring = self.m[:, None] * (self._dq - now.alpha[:, 3:5] * was)
        return relaxed + turned(now.yaw, np.concatenate([ring, 0 * ring[:, :1]], axis=1))


class Carpet(Form):
    """A carpet with a grain: walking along it is easier than across, by compass."""

    scale, outputs = 0.7, ("base_vx", "base_vy")
    depends = ("base_yaw",)

    def __init__(self, rng: np.random.Generator) -> None:
        self._grain = rng.uniform(0, np.pi)

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        u = u.copy()
        u[:, :2] *= (1 - self.m * np.cos(2 * (now.yaw - self._grain)))[:, None]
        return u


class TopHeavy(Form):
    """The base walks slower with the hand held high."""

    scale, outputs = 1.5, ("base_vx", "base_vy")
    depends = ("ee_z",)

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        u = u.copy()
        u[:, :2] *= np.clip(1 - self.m * np.maximum(now.x[:, 8] - 0.6, 0.0), 0.0, 1.0)[:, None]
        return u


class Gusts(Form):
    """Wind on the body: it comes and goes within seconds, and nobody commands it."""

    scale, outputs = 0.3, ("base_vx", "base_vy")
    depends = ("its own past",)

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        wind = rng.normal(size=(size.sessions, size.rows, 2))
        for t in range(1, size.rows):
            wind[:, t] = 0.95 * wind[:, t - 1] + 0.31 * wind[:, t]
        self._wind = size.tile(wind)

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        push = self.m[:, None] * self._wind[:, now.t]
        return u + turned(-now.yaw, np.concatenate([push, 0 * push[:, :1]], axis=1))


class Ratchet(Form):
    """The arm's gear is engaged by quick commands only: after rest it needs a jerk before slow ones are followed."""

    scale, outputs = 0.9, ("ee_vz",)
    depends = ("its own past", "cmd_ee_vz")

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._engaged = np.zeros(size.batch)

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "ee":
            return u
        if k == 0:
            jerk = np.abs(now.sent[:, 5]) > 0.5 * LIMIT[5]
            self._engaged = np.where(jerk, 1.0, self._engaged * np.exp(-TIME_STEP / 1.5))
        u = u.copy()
        u[:, 2] *= 1 - self.m * (1 - self._engaged)
        return u
