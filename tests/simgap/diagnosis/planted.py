"""Recordings with a planted truth: the augmented simulator itself, teleoperated, with process and sensor noise."""

from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from simgap.effects import CATALOGUE
from simgap.effects.augmented import Augmented, Slot
from simgap.effects.effect import HISTORY_ROWS, Earlier, Row, Scales
from simgap.effects.regime import EVERYWHERE, Regime, holds
from simgap.effects.step import advance, fading, remember, sense
from simgap.kinematics import carried_velocity
from simgap.robots import operator
from simgap.simulators.spot import Spot
from simgap.types import Recording

SPOT = Augmented(Spot())
PHI = np.array([0.5, 0.5, 0.5, 0.08, 0.08, 0.3, *[0.0] * 12, *[1.0] * 6], np.float32)
PROCESS = np.array([0.0, 0.0, 0.0, 0.012, 0.012, 0.015, 0.0, 0.0, 0.0, 0.02, 0.02, 0.02])
ADVANCES = np.array([3, 4, 5, -1, -1, -1, 9, 10, 11, -1, -1, -1])
SENSOR = np.array([0.002, 0.002, 0.003, 0.012, 0.012, 0.015, 0.003, 0.003, 0.003, 0.02, 0.02, 0.02])
SCALES = Scales(
    command=np.array([1.0, 0.7, 1.0, 0.6, 0.6, 0.6]), command_step=np.full(6, 0.15), speed=np.full((2, 4), 0.8),
    axis_speed=np.full(6, 0.8), axis_command=np.full(6, 0.8), reach=np.linspace(0.5, 1.2, 21)[None],
    height=np.linspace(0.2, 0.95, 21)[None], interval=np.full(12, 1 / 15), output=np.ones(12),
    duration=40.0, time_step=1 / 15, both_ways=np.ones(6),
)  # fmt: skip


def theta(constants: Mapping[tuple[str, int, int], float]) -> np.ndarray:
    """Internal constants from {(effect key, constant, site): value}."""
    keys = [effect.key for effect in CATALOGUE]
    out = np.zeros(len(SPOT.slots), np.float32)
    for (key, k, site), value in constants.items():
        out[SPOT.index[Slot(keys.index(key), k, site)]] = value
    return out


@partial(jax.jit, static_argnames="rows")
def _run(key, theta, during, from_s, to_s, regime, there, its_regime, lost, phi, noise, rows):
    config = operator.OperatorConfig()
    key_start, lost_key, key = jax.random.split(key, 3)
    pose = jnp.array([2.0, 2.0, 3.0]) * jax.random.uniform(key_start, (3,), minval=-1)
    hand = jnp.array([0.8, 0.0, 0.6])
    c, s = jnp.cos(pose[2]), jnp.sin(pose[2])
    p = jnp.array([pose[0] + c * hand[0], pose[1] + s * hand[0], hand[2]])
    state = jnp.concatenate([pose, jnp.zeros(3), p, jnp.zeros(3)])
    scales = jax.tree.map(jnp.asarray, SCALES)

    def row(carry, now):
        state, memory, op, sent = carry
        key, time_s = now
        k1, k2, k3 = jax.random.split(key, 3)
        here = Row(time_s, jnp.ones(()))
        measured = sense(SPOT, theta, memory, state, here) + noise * jnp.array(SENSOR) * jax.random.normal(k1, (12,))
        measured = measured.at[2].set(jnp.arctan2(jnp.sin(measured[2]), jnp.cos(measured[2])))
        op, u = operator.step(op, measured, k2, 1 / 15, config)
        acts = (time_s >= from_s) & (time_s < to_s) & holds(SPOT.layout, regime, state, u)
        constants = theta + jnp.where(acts, 1.0, 0.0) * during
        constants = constants + jnp.where(holds(SPOT.layout, its_regime, state, u), 1.0, 0.0) * there
        # Lost commands come in bursts of four rows.
        k4 = jax.random.fold_in(lost_key, (time_s * 15).astype(int) // 4)
        acted = jnp.where(jax.random.uniform(k4) < lost, sent, u)
        memory, state = advance(SPOT, phi, constants, scales, memory, state, acted, here)
        # What jolts the base carries the hand along, and both have moved by the end of the row.
        jolt = noise * jnp.array(PROCESS) * jax.random.normal(k3, (12,))
        jolt = jolt + carried_velocity(SPOT.layout, state, jolt)
        state = state + jolt + jnp.where(ADVANCES >= 0, jolt[ADVANCES], 0.0) / 15
        return (state, memory, op, acted), (measured, u)

    still = Earlier(jnp.zeros((HISTORY_ROWS + 1, 6)))
    memory = remember(SPOT, fading(SPOT, phi, theta), theta, state, still, jnp.zeros(()))
    start = (state, memory, operator.init(), jnp.zeros(6))
    times = jnp.arange(rows) / 15
    return jax.lax.scan(row, start, (jax.random.split(key, rows), times))[1]


def recordings(
    constants, seed=0, sessions=8, rows=600, noise=1.0, phi=PHI, during=None, from_s=0.0, to_s=np.inf, only=None,
    regime: Regime = EVERYWHERE, lost: float | np.ndarray = 0.0, there=None, its_regime: Regime = EVERYWHERE,
) -> list[Recording]:  # fmt: skip
    """Sessions of an operated Spot with effects planted; `noise` scales process and sensor noise.

    `during` are constants that hold from `from_s` to `to_s` and in a regime besides, in session `only` if it is given;
    `there` are constants that hold in a regime of their own;
    `lost` is the share of commands that are lost, in bursts: of all channels, or of each.
    """
    out = []
    for s in range(sessions):
        key = jax.random.fold_in(jax.random.key(seed), s)
        more = theta(during or {}) * (only in (None, s))
        planted = (jnp.asarray(a) for a in (theta(constants), more))
        second = jnp.asarray(theta(there or {})), its_regime
        y, u = _run(key, *planted, from_s, to_s, regime, *second, jnp.asarray(lost), jnp.asarray(phi), noise, rows)
        out.append(Recording(f"s{s}", np.arange(rows) / 15, np.asarray(y, np.float64), np.asarray(u, np.float64)))
    return out


def stalled(recording: Recording, share: float, seed: int) -> Recording:
    """The session with rows left out, the others stamped as if nothing were: stalls of the recorder."""
    keep = np.random.default_rng(seed).random(len(recording.time_s)) >= share
    rows = int(keep.sum())
    return Recording(recording.name, np.arange(rows) / 15, recording.state[keep], recording.command[keep])
