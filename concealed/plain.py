"""The plain robot: the kinematic model as the paper prints it, row by row, and how well it can be fitted
[Hoffman et al. 2025, Kinematic Model].

State [base x, y, yaw, vx, vy, wz, hand x, y, z, vx, vy, vz], world frame; command in the body frame. Written from the
paper alone, for B robots side by side.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TIME_STEP = 1 / 15
"""Between rows [s]."""
STATE = ("base_x", "base_y", "base_yaw", "base_vx", "base_vy", "base_wz",
         "ee_x", "ee_y", "ee_z", "ee_vx", "ee_vy", "ee_vz")  # fmt: skip
COMMAND = ("cmd_base_vx", "cmd_base_vy", "cmd_base_wz", "cmd_ee_vx", "cmd_ee_vy", "cmd_ee_vz")
P_BASE, V_BASE, P_EE, V_EE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
POSITION, VELOCITY = np.array([0, 1, 2, 6, 7, 8]), np.array([3, 4, 5, 9, 10, 11])
PARAMETERS = 24
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
    """The same, given cosine and sine [B] of the yaw."""
    out = np.empty_like(vector)
    x, y = vector[:, 0], vector[:, 1]
    out[:, 0], out[:, 1], out[:, 2] = c * x - s * y, s * x + c * y, vector[:, 2]
    return out


def carried(v_base: Array, arm: Array) -> Array:
    """Velocity that the base's motion gives the hand: D v_base + v_ind, for an `arm` [B, 2] from base to hand."""
    omega = v_base[:, 2]
    return np.stack([v_base[:, 0] - omega * arm[:, 1], v_base[:, 1] + omega * arm[:, 0], 0 * omega], axis=1)


def advance(of: Robot, x: Array, u: Array) -> Array:
    """The next row [B, 12]."""
    a, b, g = of
    out, rest = np.empty_like(x), 1 - a
    c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
    p, q = x[:, P_BASE], x[:, P_EE]
    v = a[:, :3] * x[:, V_BASE] + rest[:, :3] * turned_by(c, s, u[:, :3]) + b[:, :3]
    w = a[:, 3:] * x[:, V_EE] + rest[:, 3:] * turned_by(c, s, u[:, 3:]) + b[:, 6:9]
    w[:, 0] += v[:, 0] - v[:, 2] * (q[:, 1] - p[:, 1])
    w[:, 1] += v[:, 1] + v[:, 2] * (q[:, 0] - p[:, 0])
    out[:, P_BASE] = p + TIME_STEP * g[:, :3] * v + b[:, 3:6]
    out[:, V_BASE] = v
    out[:, P_EE] = q + TIME_STEP * g[:, 3:] * w + b[:, 9:]
    out[:, V_EE] = w
    return out


def wrapped(difference: Array) -> Array:
    """Differences of states with the yaw's between -pi and pi."""
    difference[..., 2] = (difference[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return difference


class Noise(NamedTuple):
    """Standard deviations per output [12]: of the process within a row, and of the measurement."""

    process: Array
    measured: Array


class Observer(NamedTuple):
    """Steady-state Kalman filter of every axis (position, velocity) by itself: gain and innovation covariance.

    gain, weight: [6, 2, 2]; weight is the inverse of the covariance's Cholesky factor, so that weight @ innovation is
    white with unit variance.
    """

    gain: Array
    weight: Array
    cov: Array


def observer(of: Robot, noise: Noise) -> Observer:
    """The filter for a robot [1, ...] with known noise [Kalman 1960]; the coupling between axes is left aside."""
    gains, weights, covs = [], [], []
    for i in range(6):
        p, v = POSITION[i], VELOCITY[i]
        a, g = of.alpha[0, i], TIME_STEP * of.gamma[0, i]
        F = np.array([[1.0, g * a], [0.0, a]])
        G = np.array([[1.0, g], [0.0, 1.0]])
        spread = noise.process[[p, v]] ** 2
        if i in (3, 4):  # the base's motion moves the hand as well
            spread[1] += noise.process[V_BASE][:2].mean() ** 2 + (ARM * noise.process[5]) ** 2
        Q = G @ np.diag(spread) @ G.T
        R = np.diag(noise.measured[[p, v]] ** 2)
        P, S = Q + R, R
        for _ in range(200):
            S = P + R
            P = F @ (P - P @ np.linalg.solve(S, P)) @ F.T + Q
        gains.append(P @ np.linalg.inv(S))
        weights.append(np.linalg.inv(np.linalg.cholesky(S)))
        covs.append(S)
    return Observer(np.stack(gains), np.stack(weights), np.stack(covs))


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
    of_position, of_velocity = e[:, POSITION], e[:, VELOCITY]
    x[:, POSITION] += by.gain[:, 0, 0] * of_position + by.gain[:, 0, 1] * of_velocity
    x[:, VELOCITY] += by.gain[:, 1, 0] * of_position + by.gain[:, 1, 1] * of_velocity


def whitened(by: Observer, e: Array) -> Array:
    """Innovations [..., 12] in standard deviations, decorrelated [..., 6, 2]."""
    p, v, w = e[..., POSITION], e[..., VELOCITY], by.weight
    return np.stack([w[:, 0, 0] * p, w[:, 1, 0] * p + w[:, 1, 1] * v], axis=-1)


def refit(start: Robot, by: Observer, state: Array, command: Array, rounds: int = 3) -> tuple[Array, Array]:
    """The 24 parameters that explain the rows best, by Gauss-Newton with known noise.

    state: [G, S, T, 12], G groups of S sessions fitted apart. Returns the parameters [G, 24] and their whitened
    innovations [G, S, T - 1, 6, 2].
    """
    groups, sessions = state.shape[:2]
    rows = state.shape[2]
    flat = np.tile(start.flat[:1], (groups, 1))
    step = np.concatenate([np.full(6, 1e-4), np.full(12, 1e-5), np.full(6, 1e-4)])

    def run(flat: Array) -> Array:  # [..., G, 24] -> [..., G, residuals of a group]
        lead = flat.shape[:-2]
        many = np.repeat(flat.reshape(-1, PARAMETERS), sessions, axis=0)
        copies = int(np.prod(lead, initial=1))
        tile = lambda a: np.tile(a.reshape(-1, *a.shape[2:]), (copies, 1, 1))  # noqa: E731
        e = whitened(by, innovations(robot(many), by, tile(state), tile(command)))
        return e.reshape(*lead, groups, sessions * (rows - 1) * 12)

    best = run(flat)
    for _ in range(rounds):
        moved = run(flat[None] + step[:, None, None] * np.eye(PARAMETERS)[:, None, :])
        jacobian = np.swapaxes((moved - best) / step[:, None, None], 0, 1)  # [G, 24, n]
        normal = jacobian @ np.swapaxes(jacobian, 1, 2)
        slope = (jacobian @ best[..., None])[..., 0]
        ridge = 1e-9 * np.einsum("gpp->g", normal)[:, None, None] * np.eye(PARAMETERS)
        new = flat - np.linalg.solve(normal + ridge, slope[..., None])[..., 0]
        new[:, :6] = np.clip(new[:, :6], 0.0, 0.98)
        tried = run(new)
        better = (tried**2).sum(1) < (best**2).sum(1)
        flat, best = np.where(better[:, None], new, flat), np.where(better[:, None], tried, best)
    return flat, best.reshape(groups, sessions, rows - 1, 6, 2)
