"""What happens to the arm: it sinks, carries, reaches its end, touches the floor, is thrown and dragged about."""

from typing import Any

import numpy as np

from concealed.form import SUBSTEPS, Array, Form, Now, Size
from concealed.forms.channels import outputs_of
from concealed.plain import TIME_STEP, carried, turned


class Sag(Form):
    """The arm sinks under its own weight, in proportion to the lever."""

    id, scale = "gravity_sag", 0.8
    outputs = ("ee_vz",)

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "ee":
            return u
        u = u.copy()
        u[:, 2] -= self.m * now.reach
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "sink", "value": magnitude, "unit": "1/s"}]


class Payload(Form):
    """From some time on the hand carries a load: it answers slower and sinks."""

    id, scale = "payload", 1.0
    outputs = ("ee_vx", "ee_vy", "ee_vz")
    memory, sink = 0.5, 0.15

    def __init__(self, rng: np.random.Generator) -> None:
        self._share = rng.uniform(0.25, 0.6)

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self.from_s = float(np.round(self._share * size.rows) * TIME_STEP)

    def row(self, now: Now) -> None:
        loaded = (now.t * TIME_STEP >= self.from_s - 1e-9) * self.m * self.memory
        now.alpha[:, 3:] = np.clip(now.alpha[:, 3:] + loaded[:, None], 0.0, 0.95)

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "ee":
            return u
        u = u.copy()
        u[:, 2] -= (now.t * TIME_STEP >= self.from_s - 1e-9) * self.m * self.sink
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "added memory", "value": magnitude * self.memory, "unit": "-"},
                {"name": "sink", "value": magnitude * self.sink, "unit": "m/s"},
                {"name": "onset", "value": self.from_s, "unit": "s"}]  # fmt: skip


class ReachEnd(Form):
    """A stretched arm: it goes no further out, whatever is commanded."""

    id, scale = "reach_limit", 0.9
    channels, outputs = ("cmd_ee_vx", "cmd_ee_vy"), ("ee_vx", "ee_vy")
    longest = 1.4

    def grip(self, now: Now, k: int, part: str, u: Array, before: Array, after: Array) -> Array:
        if part != "ee":
            return after
        reach = np.maximum(now.reach, 1e-6)
        radial = now.arm[:, :2] / reach[:, None]
        # Within the row the hand may come to the end, too.
        room = np.maximum(self.longest - self.m - reach, 0.0) / TIME_STEP
        outward = (after[:, :2] * radial).sum(1)
        excess = np.where(self.m > 0, np.maximum(outward - room, 0.0), 0.0)
        after = after.copy()
        after[:, :2] -= excess[:, None] * radial
        return after

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "reach", "value": self.longest - magnitude, "unit": "m"}]


class Floor(Form):
    """Uneven ground under the hand, hard."""

    id, scale = "ground_contact", 0.8
    outputs = ("ee_z", "ee_vz")
    uneven = 0.01

    def __init__(self, rng: np.random.Generator) -> None:
        self._waves, self._phases = rng.normal(0, 3.0, (5, 2)), rng.uniform(0, 2 * np.pi, 5)

    def place(self, now: Now, p: Array, v: Array) -> tuple[Array, Array]:
        ground = self.m + self.uneven * np.sin(p[:, 3:5] @ self._waves.T + self._phases).mean(1) * np.sqrt(5)
        under = (p[:, 5] < ground) & (self.m > 0)
        p, v = p.copy(), v.copy()
        p[:, 5] = np.where(under, ground, p[:, 5])
        v[:, 5] = np.where(under, np.maximum(v[:, 5], 0.0), v[:, 5])
        return p, v

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "height", "value": magnitude, "unit": "m"}]


class Thrown(Form):
    """Turning throws the hand outwards."""

    id, scale = "centripetal", 1.0
    outputs = ("ee_vx", "ee_vy")

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "ee":
            return u
        u = u.copy()
        u[:, :2] += (self.m * now.v_base[k][:, 2] ** 2)[:, None] * now.arm[:, :2]
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "coefficient", "value": magnitude, "unit": "s"}]


class Dragged(Form):
    """Accelerating the base leaves the hand behind."""

    id, scale = "base_arm_coupling", 1.0
    outputs = ("ee_vx", "ee_vy")

    def grip(self, now: Now, k: int, part: str, u: Array, before: Array, after: Array) -> Array:
        if part != "ee":
            return after
        last = now.x[:, 3:6] if k == 0 else now.v_base[k - 1]
        gained = turned(-now.yaw, now.v_base[k] - last)
        after = after.copy()
        after[:, :2] -= self.m[:, None] * gained[:, :2]
        return after

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "ratio", "value": -magnitude, "unit": "-"}]


class Reaction(Form):
    """Moving the arm moves the base the other way."""

    id, scale = "arm_base_coupling", 0.8
    outputs = ("base_vx", "base_vy")

    def command(self, now: Now, u: Array) -> Array:
        own, self._gains = now.own, np.empty((SUBSTEPS, *now.own.shape))
        rate = now.alpha[:, 3:] ** (1 / SUBSTEPS)
        for k in range(SUBSTEPS):
            new = u[k, :, 3:] + rate * (own - u[k, :, 3:])
            self._gains[k], own = new - own, new
        return u

    def grip(self, now: Now, k: int, part: str, u: Array, before: Array, after: Array) -> Array:
        if part != "base":
            return after
        after = after.copy()
        after[:, :2] -= self.m[:, None] * self._gains[k][:, :2]
        return after

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "ratio", "value": -magnitude, "unit": "-"}]


class OwnMemory(Form):
    """The memory is of the arm's own motion, not of the hand's motion in the world."""

    id, scale = "relative_smoothing", 1.0
    outputs = ("ee_vx", "ee_vy")

    def blend(self, now: Now, part: str, old: Array, relaxed: Array) -> Array:
        if part != "ee":
            return relaxed
        was = carried(now.x[:, 3:6], now.x[:, 6:8] - now.x[:, 0:2])
        return relaxed - self.m[:, None] * now.alpha[:, 3:] * was

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "share", "value": magnitude, "unit": "-"}]


class BodyMemory(Form):
    """The memory of the base's velocity is kept in its own frame, which has turned since."""

    id, scale = "relative_smoothing", 1.0
    outputs = outputs_of((0,))

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._yaw = np.full(size.batch, np.nan)

    def blend(self, now: Now, part: str, old: Array, relaxed: Array) -> Array:
        if part != "base":
            return relaxed
        since = np.where(np.isnan(self._yaw), 0.0, now.yaw - self._yaw)
        self._yaw = now.yaw.copy()
        return relaxed + self.m[:, None] * now.alpha[:, :3] * (turned(since, old) - old)

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "share", "value": magnitude, "unit": "-"}]
