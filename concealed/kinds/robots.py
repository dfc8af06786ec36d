"""The machines themselves, B of them side by side: equations of motion in mass matrices, and who drives them.

Each takes forces on top of those of its motors, and velocities of what carries it; both are what a cause adds.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concealed.form import Array
from concealed.sessions import Columns

G = 9.81

Moves = Callable[[Array, Array, Array, Array], Array]
"""(parameters [p], states [B, s], what the motors get [B, u], further forces [B, v]) -> rates of the states [B, s]."""
Drives = Callable[[Array, Array], Array]
"""(goals [B, g], what is measured [B, s]) -> commands [B, u]."""


class Kind(NamedTuple):
    """A kind of machine.

    simulator: what its user has. columns: of its recordings. low, high: of its parameters. goal: how far goals reach
    [g]. lasts: how long one is kept, from and to [s]. tremble: of the hand that drives [u]. measured, disturbed: usual
    noise of what is measured, and of the states in a row [s]. turns: which states are angles.
    """

    simulator: str
    columns: Columns
    low: Array
    high: Array
    moves: Moves
    drives: Drives
    goal: Array
    lasts: tuple[float, float]
    tremble: Array
    measured: Array
    disturbed: Array
    turns: Array

    @property
    def interval(self) -> float:
        """Between rows [s]."""
        return self.columns.time_step

    @property
    def rates(self) -> int:
        """How many of the states, which are last, are velocities: those that a force changes."""
        return int((self.disturbed > 0).sum())


def _solved(mass: list[list[Array | float]], force: Array) -> Array:
    """Accelerations [B, n] by a mass matrix, whose entries are numbers or [B]."""
    batch = len(force)
    matrix = np.stack([np.stack([np.broadcast_to(m, batch) for m in row], -1) for row in mass], -2)
    return np.linalg.solve(matrix, force[..., None])[..., 0]


def _crane(p: Array, x: Array, u: Array, push: Array) -> Array:
    cart, pole, length = p[0], p[1], 0.5
    angle, rate = x[:, 1], x[:, 3]
    s, c = np.sin(angle), np.cos(angle)
    force = np.stack([u[:, 0] + pole * length * rate**2 * s, -pole * G * length * s], -1) + push
    mass: list[list[Array | float]] = [[cart + pole, pole * length * c], [pole * length * c, pole * length**2]]
    return np.concatenate([x[:, 2:], _solved(mass, force)], 1)


def _crane_driver(goal: Array, y: Array) -> Array:
    return np.clip(8 * (goal[:, :1] - y[:, :1]) - 5 * y[:, 2:3] + goal[:, 1:], -15, 15)


def _drone(p: Array, x: Array, u: Array, push: Array) -> Array:
    up = u[:, :1] * np.stack([-np.sin(x[:, 2]), np.cos(x[:, 2])], -1)
    force = np.concatenate([up - [0.0, p[0] * G], u[:, 1:]], 1) + push
    return np.concatenate([x[:, 3:], force / [p[0], p[0], p[1]]], 1)


def _drone_driver(goal: Array, y: Array) -> Array:
    aside = np.clip(2 * (goal[:, 0] - y[:, 0]) - 2 * y[:, 3], -5, 5)
    rise = np.clip(4 * (goal[:, 1] - y[:, 1]) - 3 * y[:, 4], -6, 6)
    tilt = np.clip(-aside / G, -0.6, 0.6)
    torque = np.clip(1.2 * (tilt - y[:, 2]) - 0.18 * y[:, 5], -1, 1)
    return np.stack([G + rise, torque], -1)


def _boat(p: Array, x: Array, u: Array, push: Array) -> Array:
    mass, inertia, along, across, about = p
    yaw, surge, sway, turn = x[:, 2], x[:, 3], x[:, 4], x[:, 5]
    c, s = np.cos(yaw), np.sin(yaw)
    drive = np.stack([u[:, 0] - along * surge, -across * sway, u[:, 1] - about * turn], -1) + push
    rates = drive / [mass, mass, inertia] + np.stack([sway * turn, -surge * turn, 0 * turn], -1)
    return np.concatenate([np.stack([c * surge - s * sway, s * surge + c * sway, turn], -1), rates], 1)


def _links(p: Array, x: Array, u: Array, push: Array) -> Array:
    upper, lower, *damping = p
    a, b = 0.4, 0.35
    first, second, rate = x[:, 0], x[:, 1], x[:, 2:]
    cross, own = lower * a * b / 2, lower * b**2 / 3
    c, s = np.cos(second), np.sin(second)
    mass: list[list[Array | float]] = [
        [upper * a**2 / 3 + lower * a**2 + own + 2 * cross * c, own + cross * c],
        [own + cross * c, own],
    ]
    below = lower * G * b / 2 * np.sin(first + second)
    weight = np.stack([(upper / 2 + lower) * G * a * np.sin(first) + below, below], -1)
    whirl = cross * s * np.stack([-rate[:, 1] * (2 * rate[:, 0] + rate[:, 1]), rate[:, 0] ** 2])
    return np.concatenate([rate, _solved(mass, u - damping * rate - weight - whirl.T + push)], 1)


def _links_driver(goal: Array, y: Array) -> Array:
    below = 0.46 * G * 0.35 * np.sin(y[:, 0] + y[:, 1])
    held = np.stack([1.72 * G * 0.4 * np.sin(y[:, 0]) + below, below], -1)
    return held + [12.0, 4.0] * (goal - y[:, :2]) - [1.5, 0.4] * y[:, 2:]


def _wheels(p: Array, x: Array, u: Array, push: Array) -> Array:
    yaw, speed, turn = x[:, 2], x[:, 3], x[:, 4]
    rates = (u - x[:, 3:]) / p + push
    return np.concatenate([np.stack([speed * np.cos(yaw), speed * np.sin(yaw), turn], -1), rates], 1)


def _as_wished(goal: Array, y: Array) -> Array:
    return goal


_POSE = ("x", "y", "yaw")
CRANE = Kind(
    "examples.kinds:CRANE", Columns(("cart_x", "pole_angle", "cart_v", "pole_rate"), ("force",), 0.02),
    np.array([0.5, 0.05]), np.array([2.0, 0.5]), _crane, _crane_driver, np.array([1.0, 5.0]), (0.3, 1.2),
    np.array([0.1]), np.array([1e-3, 2e-3, 1e-2, 2e-2]), np.array([0, 0, 2e-3, 4e-3]), np.array([0, 1, 0, 0], bool),
)  # fmt: skip
DRONE = Kind(
    "examples.kinds:DRONE", Columns(("x", "z", "pitch", "vx", "vz", "pitch_rate"), ("thrust", "torque"), 0.02),
    np.array([0.8, 0.007]), np.array([1.3, 0.014]), _drone, _drone_driver, np.array([2.0, 2.0]), (0.6, 1.5),
    np.array([0.2, 0.02]), np.array([3e-3, 3e-3, 3e-3, 2e-2, 2e-2, 2e-2]), np.array([0, 0, 0, 3e-3, 3e-3, 6e-3]),
    np.array([0, 0, 1, 0, 0, 0], bool),
)  # fmt: skip
BOAT = Kind(
    "examples.kinds:BOAT", Columns((*_POSE, "surge", "sway", "turn"), ("thrust", "moment"), 0.1),
    np.array([20.0, 3.0, 8.0, 40.0, 4.0]), np.array([45.0, 8.0, 30.0, 120.0, 15.0]), _boat, _as_wished,
    np.array([30.0, 8.0]), (1.5, 5.0), np.array([2.0, 0.5]), np.array([2e-2, 2e-2, 5e-3, 1e-2, 1e-2, 5e-3]),
    np.array([0, 0, 0, 2e-3, 2e-3, 2e-3]), np.array([0, 0, 1, 0, 0, 0], bool),
)  # fmt: skip
TWO_LINKS = Kind(
    "examples.kinds:TWO_LINKS",
    Columns(("shoulder", "elbow", "shoulder_rate", "elbow_rate"), ("shoulder_torque", "elbow_torque"), 0.01),
    np.array([1.2, 0.8, 0.05, 0.05]), np.array([1.9, 1.2, 0.3, 0.3]), _links, _links_driver, np.array([1.2, 1.2]),
    (0.4, 1.0), np.array([0.1, 0.05]), np.array([5e-4, 5e-4, 1e-2, 1e-2]), np.array([0, 0, 2e-3, 2e-3]),
    np.array([1, 1, 0, 0], bool),
)  # fmt: skip
TWO_WHEELS = Kind(
    "examples.kinds:TWO_WHEELS", Columns((*_POSE, "speed", "turn"), ("cmd_speed", "cmd_turn"), 0.05),
    np.array([0.1, 0.1]), np.array([0.4, 0.4]), _wheels, _as_wished, np.array([1.0, 1.5]), (0.5, 2.0),
    np.array([0.05, 0.1]), np.array([5e-3, 5e-3, 3e-3, 1e-2, 1e-2]), np.array([0, 0, 0, 2e-3, 3e-3]),
    np.array([0, 0, 1, 0, 0], bool),
)  # fmt: skip
KINDS = {"crane": CRANE, "drone": DRONE, "boat": BOAT, "two links": TWO_LINKS, "two wheels": TWO_WHEELS}
