"""The robot itself, in substeps, with concealed effects at work in it.

Within a row the command is held and turned into the world frame once; velocities relax towards it by alpha^(1/K) a
substep, so that without an effect K substeps are exactly the paper's row. Positions then advance over the same
substeps by the row's last velocity, as the paper's do.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from concealed.form import SUBSTEPS, Array, Form, Now, Size
from concealed.plain import P_BASE, P_EE, TIME_STEP, V_BASE, V_EE, Noise, Robot, carried, turned, turned_by

Operator = Callable[[int, Array], Array]
"""What commands the robot at row t on seeing the measured state [B, 12]: the command [B, 6]."""
Gate = Callable[[int, Array, Array], Array]
"""Where a form acts: 0 or 1 [B], from the row's number, the true state and the command sent."""
LIMIT = 1e4
"""Beyond it a state counts as lost, and is held there."""


class Tape(NamedTuple):
    """What was recorded, and what truly was: measured and true states [B, T, 12], commands [B, T, 6]; gate [B, T]."""

    measured: Array
    true: Array
    command: Array
    gate: Array


class Chance(NamedTuple):
    """Standard normal draws of process and measurement [B, T, 12], and what is added to measurements besides."""

    process: Array
    measured: Array
    outliers: Array


class Setting(NamedTuple):
    """What a run has whatever is concealed in it: robot, operator, true first state [B, 12], noise, chance, size."""

    robot: Robot
    operate: Operator
    first: Array
    noise: Noise
    chance: Chance
    size: Size


def run(setting: Setting, forms: Sequence[Form], magnitude: Array, gate: Gate | None) -> Tape:
    """Rows of a session, at a magnitude [B, F] for every form; without a gate the forms always act."""
    hooks = {h: [f for f in forms if f.overrides(h)] for h in Form.hooks}
    noise, chance = setting.noise, setting.chance
    rows, batch = setting.size.rows, setting.size.batch
    true, seen = np.empty((rows, batch, 12)), np.empty((rows, batch, 12))
    sent, gated = np.empty((rows, batch, 6)), np.ones((rows, batch))
    now = Now()
    now.x, now.own = setting.first.copy(), np.zeros((batch, 3))
    for f, m in zip(forms, magnitude.T, strict=True):
        f.m = m
    for t in range(rows):
        true[t] = now.x
        spread = noise.measured * chance.measured[:, t]
        for f in hooks["scatter"]:
            spread = f.scatter(t, true, spread)
        y = now.x
        for f in hooks["sense"]:
            y = f.sense(t, true, y)
        y = y + spread + chance.outliers[:, t]
        y[:, 2] = (y[:, 2] + np.pi) % (2 * np.pi) - np.pi
        seen[t] = y
        sent[t] = setting.operate(t, y)
        if gate is not None:
            gated[t] = gate(t, now.x, sent[t])
            for f, m in zip(forms, magnitude.T, strict=True):
                f.m = m * gated[t]
        if t < rows - 1:
            now.t, now.sent = t, sent[t]
            now.x = _row(setting.robot, now, hooks, noise.process * chance.process[:, t])
    order = lambda a: np.ascontiguousarray(np.swapaxes(a, 0, 1))  # noqa: E731
    return Tape(order(seen), order(true), order(sent), np.ascontiguousarray(gated.T))


def _row(of: Robot, now: Now, hooks: dict[str, list[Form]], process: Array) -> Array:
    x, K = now.x, SUBSTEPS
    yaw = x[:, 2]
    now.alpha, now.duration = of.alpha.copy(), np.ones(len(x))
    now.arm = turned(-yaw, x[:, P_EE] - np.stack([x[:, 0], x[:, 1], 0 * yaw], axis=1))
    lever = x[:, 6:8] - x[:, 0:2]
    now.v_body = np.concatenate([turned(-yaw, x[:, V_BASE]), now.own], axis=1)
    for f in hooks["row"]:
        f.row(now)
    u = np.repeat(now.sent[None], K, axis=0)
    for f in hooks["command"]:
        u = f.command(now, u)
    rate = now.alpha ** (now.duration[:, None] / K)
    still = of.beta[:, :3] / (1 - now.alpha[:, :3])
    base = _relax(now, hooks, "base", u[:, :, :3], _Relaxation(x[:, V_BASE], rate[:, :3], still))
    base = base + process[:, V_BASE]
    moved = (of.beta[:, 6:9] + carried(base, lever)) / (1 - now.alpha[:, 3:])
    hand = _relax(now, hooks, "ee", u[:, :, 3:], _Relaxation(x[:, V_EE], rate[:, 3:], moved))
    now.own = turned(-yaw, hand - moved)
    hand = hand + process[:, V_EE]
    velocity = np.concatenate([base, hand], axis=1)
    by = velocity
    for f in hooks["shift"]:
        by = f.shift(now, by)
    step = now.duration[:, None] * TIME_STEP * of.gamma * by
    drift = np.concatenate([of.beta[:, 3:6] + process[:, P_BASE], of.beta[:, 9:] + process[:, P_EE]], axis=1)
    place = np.concatenate([x[:, P_BASE], x[:, P_EE]], axis=1)
    if hooks["place"]:
        for _ in range(K):
            place = place + (step + drift) / K
            for f in hooks["place"]:
                place, velocity = f.place(now, place, velocity)
    else:
        place = place + step + drift
    out = np.concatenate([place[:, :3], velocity[:, :3], place[:, 3:], velocity[:, 3:]], axis=1)
    return np.clip(np.nan_to_num(out, nan=LIMIT), -LIMIT, LIMIT)


class _Relaxation(NamedTuple):
    """How a velocity follows its command: from `start` [B, 3], what is missing to the command plus `offset` [B, 3] is
    multiplied by `rate` [B, 3] in every substep."""

    start: Array
    rate: Array
    offset: Array


def _relax(now: Now, hooks: dict[str, list[Form]], part: str, u: Array, relaxation: _Relaxation) -> Array:
    """Velocity in the world frame at the row's end, driven by commands over substeps.

    Forms see the velocity less the offset, in the body frame: of the hand that is the velocity of the arm by itself.
    """
    start, rate, offset = relaxation
    drives, grips, v = hooks["drive"], hooks["grip"], start
    cos, sin = np.cos(now.yaw), np.sin(now.yaw)
    path = np.empty((SUBSTEPS, *start.shape))
    for k in range(SUBSTEPS):
        goal, mine = u[k], v
        if drives or grips:
            mine = turned_by(cos, -sin, v - offset)
        for f in drives:
            goal = f.drive(now, k, part, goal, mine)
        target = turned_by(cos, sin, goal) + offset
        v = target + rate * (v - target)
        if grips:
            after = turned_by(cos, -sin, v - offset)
            for f in grips:
                after = f.grip(now, k, part, goal, mine, after)
            v = turned_by(cos, sin, after) + offset
        path[k] = v
    if part == "base":
        now.v_base = path
    for f in hooks["blend"]:
        v = f.blend(now, part, start, v)
    return v
