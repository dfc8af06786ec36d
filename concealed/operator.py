"""Who commands the robot: a person at a joystick, who looks at the measured state and changes their mind."""

from typing import NamedTuple

import numpy as np

from concealed.form import Array, Size
from concealed.plain import TIME_STEP, turned

LIMIT = np.array([0.8, 0.5, 0.9, 0.6, 0.6, 0.5])
"""Greatest commands [m/s, m/s, rad/s, m/s, m/s, m/s]."""
LEVEL, WAVE, GOAL, REST, STEPS = range(5)
"""What a channel is commanded for some seconds: a level, a wave, what a goal calls for, nothing, reversals."""
ODDS = (0.26, 0.2, 0.22, 0.17, 0.15)
ROOM = 3.5
"""Distance from the middle of the room at which one turns back [m]."""
LOW, HIGH = np.array([0.45, -0.55, 0.2]), np.array([1.0, 0.55, 1.1])
"""Box in the body frame in which the hand is kept [m]."""


class Habits(NamedTuple):
    """zeal: size of commands, 1 as usual. channels: 0 or 1 for each command, whether it is used at all."""

    zeal: float
    channels: Array


class Person:
    """Closed loop over the measured states; what they want is drawn anew every second or so, alike for all copies."""

    def __init__(self, habits: Habits, size: Size, rng: np.random.Generator) -> None:
        s, rows = size.sessions, size.rows
        draw = {name: np.zeros((rows, s, 6)) for name in ("kind", "level", "hertz", "phase", "goal", "ease")}
        for i in range(s):
            for c in range(6):
                t = 0
                while t < rows:
                    end = t + int(rng.integers(8, 60))
                    kind = rng.choice(5, p=ODDS)
                    level = LIMIT[c] * np.exp(rng.uniform(np.log(0.06), np.log(1.15))) * rng.choice([-1, 1])
                    values = (kind, np.clip(level, -LIMIT[c], LIMIT[c]), np.exp(rng.uniform(np.log(0.2), np.log(1.6))),
                              rng.uniform(0, 2 * np.pi), rng.uniform(-1, 1), rng.choice([0.0, 0.5, 0.8]))  # fmt: skip
                    for name, value in zip(draw, values, strict=True):
                        draw[name][t:end, i, c] = value
                    t = end
        tremor = rng.normal(size=(rows, s, 6))
        for t in range(1, rows):
            tremor[t] = 0.9 * tremor[t - 1] + 0.43 * tremor[t]
        self._tremor = np.stack([size.tile(a) for a in tremor])
        self._plan = {name: np.stack([size.tile(a) for a in values]) for name, values in draw.items()}
        self._habits, self._last = habits, np.zeros((size.batch, 6))

    def __call__(self, t: int, seen: Array) -> Array:
        plan = {name: values[t] for name, values in self._plan.items()}
        time = t * TIME_STEP
        wave = np.sin(2 * np.pi * plan["hertz"] * time + plan["phase"])
        arm = turned(-seen[:, 2], seen[:, 6:9] - np.stack([seen[:, 0], seen[:, 1], 0 * seen[:, 2]], axis=1))
        home = turned(-seen[:, 2], -seen[:, 0:3])
        heading = np.arctan2(-seen[:, 1], -seen[:, 0]) - seen[:, 2]
        want = np.empty_like(self._last)
        want[:, :2] = 0.9 * (home[:, :2] + 1.5 * plan["goal"][:, :2])
        want[:, 2] = 1.2 * np.sin(plan["goal"][:, 2] * np.pi - seen[:, 2])
        want[:, 3:] = 1.5 * ((LOW + HIGH) / 2 + plan["goal"][:, 3:] * (HIGH - LOW) / 2 - arm)
        kind, level = plan["kind"], plan["level"]
        u = np.select([kind == LEVEL, kind == WAVE, kind == GOAL, kind == STEPS],
                      [level, level * wave, np.clip(want, -1, 1) * np.abs(level), level * np.sign(wave)])  # fmt: skip
        # Nobody's hand is still while they steer.
        u = u + np.where(kind == REST, 0.0, 0.03) * self._tremor[t] * LIMIT
        u = u * self._habits.zeal * self._habits.channels
        u = self._bounded(u, arm, seen, heading, home)
        u = np.clip(plan["ease"] * self._last + (1 - plan["ease"]) * u, -LIMIT, LIMIT)
        # Beyond the box there is no time for ease.
        self._last = u
        return np.round(u, 4)

    def _bounded(self, u: Array, arm: Array, seen: Array, heading: Array, home: Array) -> Array:
        u = u.copy()
        low, high = arm < LOW, arm > HIGH
        u[:, 3:] = np.where(low, np.maximum(u[:, 3:], 1.2 * (LOW - arm) + 0.05), u[:, 3:])
        u[:, 3:] = np.where(high, np.minimum(u[:, 3:], 1.2 * (HIGH - arm) - 0.05), u[:, 3:])
        far = np.hypot(seen[:, 0], seen[:, 1]) > ROOM
        u[:, 0] = np.where(far, 0.5 * np.clip(home[:, 0], -1, 1), u[:, 0])
        u[:, 1] = np.where(far, 0.4 * np.clip(home[:, 1], -1, 1), u[:, 1])
        return u
