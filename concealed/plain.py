"""The plain robot: the kinematic model as the paper prints it, row by row, and how well it can be fitted
[Hoffman et al. 2025, Kinematic Model].

State [base x, y, yaw, vx, vy, wz, hand x, y, z, vx, vy, vz], world frame; command in the body frame. Written from the
paper alone, for B robots side by side.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

TIME_STEP = 1 / 15
"""Between rows [s]."""
STATE = ("base_x", "base_y", "base_yaw", "base_vx", "base_vy", "base_wz",
         "ee_x", "ee_y", "ee_z", "ee_vx", "ee_vy", "ee_vz")  # fmt: skip
COMMAND = ("cmd_base_vx", "cmd_base_vy", "cmd_base_wz", "cmd_ee_vx", "cmd_ee_vy", "cmd_ee_vz")
P_BASE, V_BASE, P_EE, V_EE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
POSITION, VELOCITY = np.array([0, 1, 2, 6, 7, 8]), np.array([3, 4, 5, 9, 10, 11])
PARAMETERS = 24
SETTLED = 150
"""Rows after which a filter is as good as steady."""
ARM = 0.5
"""Usual lever from base to hand across the motion of each axis [m]."""


class Robot(NamedTuple):
    """alpha: velocity memory [B, 6]; beta: shifts of velocity and position [B, 12]; gamma: of the advance [B, 6]."""

    alpha: Array
    beta: Array
    gamma: Array

    @property
    def flat(self) -> Array:
        """All 24 numbers [B, 24]."""
        return np.concatenate(self, axis=1)


def robot(flat: Array) -> Robot:
    """Inverse of `Robot.flat`."""
    return Robot(flat[..., :6], flat[..., 6:18], flat[..., 18:])


def turned(yaw: Array, horizontal: Array) -> Array:
    """Vectors [B, 3] turned by the yaw [B] about the vertical; a third component stays."""
    return turned_by(np.cos(yaw), np.sin(yaw), horizontal)


def turned_by(c: Array, s: Array, vector: Array) -> Array:
    """The same, given cosine and sine of the yaw."""
    out = np.empty_like(vector)
    x, y = vector[..., 0], vector[..., 1]
    out[..., 0], out[..., 1], out[..., 2] = c * x - s * y, s * x + c * y, vector[..., 2]
    return out


def carried(v_base: Array, arm: Array) -> Array:
    """Velocity that the base's motion gives the hand: D v_base + v_ind, for an `arm` [B, 2] from base to hand."""
    omega = v_base[:, 2]
    return np.stack([v_base[:, 0] - omega * arm[:, 1], v_base[:, 1] + omega * arm[:, 0], 0 * omega], axis=1)


def advance(of: Robot, x: Array, u: Array) -> Array:
    """The next row [B, 12]."""
    # Both bodies at once: on some dozens of robots a call of numpy costs as much as its numbers.
    bodies = (len(x), 2, 3)
    a, b, g = of.alpha.reshape(-1, 2, 3), of.beta.reshape(-1, 2, 2, 3), of.gamma.reshape(-1, 2, 3)
    now, out = x.reshape(-1, 2, 2, 3), np.empty((len(x), 2, 2, 3), x.dtype)
    p = now[:, :, 0]
    c, s = np.cos(x[:, 2, None]), np.sin(x[:, 2, None])
    v = a * now[:, :, 1] + (1 - a) * turned_by(c, s, u.reshape(bodies)) + b[:, :, 0]
    base, hand, arm = v[:, 0], v[:, 1], p[:, 1] - p[:, 0]
    hand[:, 0] += base[:, 0] - base[:, 2] * arm[:, 1]
    hand[:, 1] += base[:, 1] + base[:, 2] * arm[:, 0]
    out[:, :, 0] = p + TIME_STEP * g * v + b[:, :, 1]
    out[:, :, 1] = v
    return out.reshape(-1, 12)


def wrapped(difference: Array) -> Array:
    """Differences of states with the yaw's between -pi and pi."""
    difference[..., 2] = (difference[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return difference


class Noise(NamedTuple):
    """Standard deviations per output [12]: of the process within a row, and of the measurement."""

    process: Array
    measured: Array


class Observer(NamedTuple):
    """A steady-state filter of every axis (position, velocity) by itself.

    gain [..., 6, 2, 2]; cov: of its innovations [..., 6, 2, 2]; weight: inverse of the covariance's Cholesky factor, so
    that weight @ innovation is white with unit variance.
    """

    gain: Array
    cov: Array
    weight: Array


EAGER = (0.0, 0.25, 0.65)
"""Shares of the way from the best gain for the noise to full trust in what is measured."""


def observers(of: Robot, noise: Noise) -> Observer:
    """Filters [len(EAGER), ...] for a robot [1, ...] with known noise; the first is Kalman's [Kalman 1960].

    The coupling between axes is left aside, but for the noise that the base hands on to the hand.
    """
    a, g, eye = of.alpha[0], TIME_STEP * of.gamma[0], np.eye(2)
    F, G = np.tile(eye, (6, 1, 1)), np.tile(eye, (6, 1, 1))
    F[:, 0, 1], F[:, 1, 1], G[:, 0, 1] = g * a, a, g
    spread = np.stack([noise.process[POSITION], noise.process[VELOCITY]], axis=1) ** 2
    # The base's motion moves the hand as well.
    spread[[3, 4], 1] += noise.process[V_BASE][:2].mean() ** 2 + (ARM * noise.process[5]) ** 2
    Q = (G * spread[:, None]) @ np.swapaxes(G, 1, 2)
    R = eye * np.stack([noise.measured[POSITION], noise.measured[VELOCITY]], axis=1)[:, None] ** 2
    P = Q + R
    for _ in range(SETTLED):
        K = P @ np.linalg.inv(P + R)
        P = F @ (P - K @ P) @ np.swapaxes(F, 1, 2) + Q
    best = P @ np.linalg.inv(P + R)
    gains = best + np.reshape(EAGER, (-1, 1, 1, 1)) * (eye - best)
    kept, measured = F @ (eye - gains), F @ gains
    added = measured @ R @ np.swapaxes(measured, -1, -2) + Q
    covs = np.tile(P, (len(EAGER), 1, 1, 1))
    for _ in range(SETTLED):
        covs = kept @ covs @ np.swapaxes(kept, -1, -2) + added
    covs = covs + R
    return Observer(gains, covs, np.linalg.inv(np.linalg.cholesky(covs)))


def observer(of: Robot, noise: Noise) -> Observer:
    """The Kalman filter alone."""
    return Observer(*(a[0] for a in observers(of, noise)))


def innovations(of: Robot, by: Observer, state: Array, command: Array) -> Array:
    """What measured rows [B, T, 12] add to what the plain robot foretells from those before them [B, T - 1, 12]."""
    x = state[:, 0].copy()
    out = np.empty((state.shape[0], state.shape[1] - 1, 12))
    for t in range(out.shape[1]):
        x = advance(of, x, command[:, t])
        e = wrapped(state[:, t + 1] - x)
        out[:, t] = e
        correct(by, x, e)
    return out


def correct(by: Observer, x: Array, e: Array) -> None:
    """Correct an estimate [B, 12] in place by innovations [B, 12]."""
    by_body = e.reshape(-1, 2, 2, 3)
    of_position, of_velocity = by_body[:, :, 0], by_body[:, :, 1]
    gain, moved = by.gain.reshape(-1, 2, 3, 2, 2), np.empty(by_body.shape)
    for i in range(2):
        moved[:, :, i] = gain[..., i, 0] * of_position + gain[..., i, 1] * of_velocity
    x += moved.reshape(-1, 12)


def whitened(by: Observer, e: Array) -> Array:
    """Innovations [..., 12] in standard deviations, decorrelated [..., 6, 2]."""
    p, v, w = e[..., POSITION], e[..., VELOCITY], by.weight
    return np.stack([w[..., 0, 0] * p, w[..., 1, 0] * p + w[..., 1, 1] * v], axis=-1)


def refit(start: Robot, by: Observer, state: Array, command: Array, rounds: int = 4) -> tuple[Array, Array]:
    """The 24 parameters that explain the rows best, by Gauss-Newton with known noise.

    state: [G, S, T, 12], G groups of S sessions fitted apart, each with a filter of its own ([G, ...] in `by`) or all
    with one. Returns the parameters [G, 24] and their innovations [G, S, T - 1, 12].
    """
    groups, sessions, rows = state.shape[:3]
    flat = np.tile(start.flat[:1], (groups, 1))
    step = np.concatenate([np.full(6, 1e-4), np.full(12, 1e-5), np.full(6, 1e-4)])
    per_group = by.gain.ndim == 4

    def run(flat: Array) -> Array:  # [N, G, 24] -> [N, G, S, T - 1, 12]
        copies = len(flat)
        many = robot(np.repeat(flat.reshape(-1, PARAMETERS), sessions, axis=0))
        tile = lambda a: np.tile(a.reshape(-1, *a.shape[2:]), (copies, 1, 1))  # noqa: E731
        gain = np.tile(np.repeat(by.gain, sessions, axis=0), (copies, 1, 1, 1)) if per_group else by.gain
        e = innovations(many, by._replace(gain=gain), tile(state), tile(command))
        return e.reshape(copies, groups, sessions, rows - 1, 12)

    weight = by.weight[:, None, None] if per_group else by.weight
    flatten = lambda e: whitened(by._replace(weight=weight), e).reshape(*e.shape[:2], -1)  # noqa: E731
    e = run(flat[None])
    best = flatten(e)[0]
    moved = flatten(run(flat[None] + step[:, None, None] * np.eye(PARAMETERS)[:, None, :]))
    jacobian = np.swapaxes((moved - best) / step[:, None, None], 0, 1)  # [G, 24, n]
    normal = jacobian @ np.swapaxes(jacobian, 1, 2)
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(PARAMETERS)
    for _ in range(rounds):  # the rows are nearly linear in the parameters: one Jacobian serves all rounds
        slope = (jacobian @ best[..., None])[..., 0]
        new = flat - np.linalg.solve(normal, slope[..., None])[..., 0]
        new[:, :6] = np.clip(new[:, :6], 0.0, 0.98)
        tried = run(new[None])
        white = flatten(tried)[0]
        better = (white**2).sum(1) < (best**2).sum(1)
        flat, best = np.where(better[:, None], new, flat), np.where(better[:, None], white, best)
        e = np.where(better[None, :, None, None, None], tried, e)
    return flat, e[0]
