"""What base and floor do to each other: friction, drag, slip, slopes, pushes, stepping; about which point one turns."""

from typing import Any

import numpy as np

from concealed.form import SUBSTEPS, Array, Form, Now, Size
from concealed.forms.channels import UNITS, outputs_of
from concealed.plain import COMMAND, TIME_STEP, turned


class OnAxis(Form):
    """A form that resists one axis of the base or the arm."""

    def __init__(self, rng: np.random.Generator, axis: int | None = None) -> None:
        self.axis = int(rng.integers(6)) if axis is None else axis
        self.part, self.i = ("base", "ee")[self.axis // 3], self.axis % 3
        self.channels, self.outputs = (COMMAND[self.axis],), outputs_of((self.axis,))

    @property
    def unit(self) -> str:
        return UNITS[self.axis]


class StickSlip(OnAxis):
    """Dry friction that holds a third better than it rubs: what stands sticks, and breaks away at once."""

    id, scale = "coulomb_friction", 0.3
    hold = 1.3

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        self._stuck = np.ones(size.batch, bool)

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != self.part:
            return u
        i, u = self.i, u.copy()
        self._rubs = self.m * np.where(np.abs(v[:, i]) > 1e-6, np.sign(v[:, i]), np.sign(u[:, i]))
        u[:, i] -= self._rubs
        return u

    def grip(self, now: Now, k: int, part: str, u: Array, before: Array, after: Array) -> Array:
        if part != self.part:
            return after
        i, after = self.i, after.copy()
        # More pulls at what stands than its command: it turns with the base, and the axes of the world relax apart.
        # Were it held against that by any force, friction of next to nothing would be a strong effect.
        pull = after[:, i] / self._answer(now) + self._rubs
        held = np.abs(pull) <= self.hold * self.m
        self._stuck = held & (self._stuck | (before[:, i] * after[:, i] <= 0))
        after[:, i] = np.where(self._stuck, 0.0, after[:, i])
        return after

    def _answer(self, now: Now) -> Array:
        """Share of a drive along the axis that becomes velocity within a substep [B]."""
        alpha = now.alpha[:, :3] if self.part == "base" else now.alpha[:, 3:]
        answer = 1 - alpha ** (now.duration[:, None] / SUBSTEPS)
        turn = np.sin(now.yaw) ** 2 if self.i < 2 else 0.0
        return (1 - turn) * answer[:, self.i] + turn * answer[:, 1 - self.i]

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "loss", "value": magnitude, "unit": self.unit}]


class Viscous(OnAxis):
    """A resistance in proportion to the speed."""

    id, scale = "viscous_drag", 1.5
    accept = ("gain",)
    why = "with another alpha a constant fraction of the command is the same motion, exactly so in yaw and height"

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != self.part:
            return u
        u = u.copy()
        u[:, self.i] -= self.m * v[:, self.i]
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "coefficient", "value": magnitude, "unit": "-"}]


class Quadratic(OnAxis):
    """A resistance growing with the square of the speed."""

    id, scale = "quadratic_drag", 4.0

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != self.part:
            return u
        u = u.copy()
        u[:, self.i] -= self.m * np.abs(v[:, self.i]) * v[:, self.i]
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "coefficient", "value": magnitude, "unit": "s/rad" if self.axis == 2 else "s/m"}]


class Slip(Form):
    """Feet lose ground in a turn, now more, now less, as the step falls."""

    id, scale = "slip", 0.9
    channels, outputs = ("cmd_base_vx", "cmd_base_vy"), ("base_vx", "base_vy")

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        steps = size.rows // 6 + 1
        self._hold = size.tile(np.repeat(rng.uniform(0.7, 1.3, (size.sessions, steps)), 6, axis=1))

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        u = u.copy()
        lost = np.clip(self.m * self._hold[:, now.t] * np.abs(v[:, 2]), 0.0, 1.0)
        u[:, :2] *= (1 - lost)[:, None]
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "loss", "value": magnitude, "unit": "s/rad"}]


class Slope(Form):
    """A floor tilted one way on the whole, and uneven: it pulls in proportion to walking."""

    id, scale = "slope", 0.6
    channels, outputs = (), ("base_vx", "base_vy")
    uneven = 0.3

    def __init__(self, rng: np.random.Generator) -> None:
        self._to = rng.uniform(0, 2 * np.pi)
        self._waves, self._phases = rng.normal(0, 1.5, (6, 2)), rng.uniform(0, 2 * np.pi, (6, 2))

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        along = now.x[:, :2] @ self._waves.T
        bumps = self.uneven * np.stack([np.sin(along + p).mean(1) * np.sqrt(12) for p in self._phases.T], axis=1)
        pull = np.array([np.cos(self._to), np.sin(self._to)]) + bumps
        speed = np.hypot(v[:, 0], v[:, 1])
        world = np.concatenate([(self.m * speed)[:, None] * pull, 0 * speed[:, None]], axis=1)
        return u + turned(-now.yaw, world)

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        pull = {"x": np.cos(self._to), "y": np.sin(self._to)}
        return [{"name": f"pull {a}", "value": float(magnitude * p), "unit": "-"} for a, p in pull.items()]


class Crab(Form):
    """A steady drift in the robot's own frame, that wanders a little."""

    id, scale = "body_frame_bias", 0.25

    def __init__(self, rng: np.random.Generator, axis: int | None = None) -> None:
        self.i = int(rng.integers(2)) if axis is None else axis
        self.outputs, self._sign = ("base_vx", "base_vy"), rng.choice([-1.0, 1.0])

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        walk = np.cumsum(rng.normal(0, 0.02, (size.sessions, size.rows)), axis=1)
        self._wander = size.tile(1 + np.clip(walk, -0.3, 0.3))

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        u = u.copy()
        u[:, self.i] += self._sign * self.m * self._wander[:, now.t]
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": f"drift {'xy'[self.i]}", "value": self._sign * magnitude, "unit": "m/s"}]


class Push(Form):
    """Somebody pushes the base for a while in one session, rising and easing off; in the world frame."""

    id, scale = "external_push", 0.6

    def __init__(self, rng: np.random.Generator) -> None:
        self._to, self._share = rng.uniform(0, 2 * np.pi), rng.uniform(0.25, 0.65)
        self._length = rng.uniform(1.0, 3.0)
        self.outputs = ("base_vx", "base_vy")

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        # Of sessions that are held out nothing could be learnt: every fourth.
        self.session = int(rng.choice([s for s in range(size.sessions) if s % 4 != 3]))
        self.from_s = self._share * size.rows * TIME_STEP
        self._here = size.tile((np.arange(size.sessions) == self.session).astype(float))

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        since = now.t * TIME_STEP - self.from_s
        force = np.clip(min(since, self._length - since) / 0.15, 0.0, 1.0)
        push = (force * self.m * self._here)[:, None] * np.array([np.cos(self._to), np.sin(self._to), 0.0])
        return u + turned(-now.yaw, push)

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "velocity", "value": magnitude, "unit": "m/s"},
                {"name": "from", "value": self.from_s, "unit": "s"},
                {"name": "to", "value": self.from_s + self._length, "unit": "s"}]  # fmt: skip


class OffCentre(Form):
    """The base turns about another point than its origin."""

    id, scale = "rotation_centre", 0.5
    outputs = ("base_vx", "base_vy")

    def __init__(self, rng: np.random.Generator) -> None:
        self._to = rng.uniform(0, 2 * np.pi)

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        if part != "base":
            return u
        u = u.copy()
        u[:, 0] += v[:, 2] * self.m * np.sin(self._to)
        u[:, 1] -= v[:, 2] * self.m * np.cos(self._to)
        return u

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        at = {"x": np.cos(self._to), "y": np.sin(self._to)}
        return [{"name": f"offset {a}", "value": float(magnitude * o), "unit": "m"} for a, o in at.items()]


class Gait(Form):
    """Stepping shakes body or hand, the more the faster one walks, at a frequency that is not quite steady."""

    id, scale = "gait_oscillation", 0.3

    def __init__(self, rng: np.random.Generator) -> None:
        self.axis = int(rng.choice([1, 2, 5]))
        self.outputs = (("base_vx", "base_vy"), ("base_wz",), ("ee_vz",))[(1, 2, 5).index(self.axis)]
        self.hertz = rng.uniform(1.4, 2.6)

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        turns = self.hertz * TIME_STEP * (1 + 0.05 * rng.normal(size=(size.sessions, size.rows)))
        self._shake = size.tile(np.sin(2 * np.pi * (rng.uniform(size=(size.sessions, 1)) + np.cumsum(turns, 1))))
        self._before = np.zeros(size.batch)

    def blend(self, now: Now, part: str, old: Array, relaxed: Array) -> Array:
        if part != ("base", "ee")[self.axis // 3]:
            return relaxed
        speed = np.hypot(now.x[:, 3], now.x[:, 4]) + 0.3 * np.abs(now.x[:, 5])
        shake = self.m * self._shake[:, now.t] * np.clip(0.3 + speed / 0.3, 0.0, 1.0)
        added = np.zeros_like(relaxed)
        added[:, self.axis % 3] = shake - now.alpha[:, self.axis] * self._before
        self._before = shake
        return relaxed + (turned(now.yaw, added) if part == "base" else added)

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        return [{"name": "amplitude", "value": magnitude, "unit": UNITS[self.axis]},
                {"name": "frequency", "value": self.hertz, "unit": "Hz"}]  # fmt: skip
