"""Magnitudes of a recording set: the scales at which effects are looked for."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales, axis_indices, floored, reaching
from simgap.layout import motion
from simgap.types import Recording

QUANTILES = np.linspace(0, 1, 21)
TINY = 1e-6


def measure(augmented: Augmented, recordings: Sequence[Recording]) -> Scales:
    """Scales of all sessions together."""
    layout = augmented.layout
    states = np.concatenate([r.state for r in recordings])
    commands = np.concatenate([r.command for r in recordings])
    changes = np.abs(np.concatenate([np.diff(r.command, axis=0) for r in recordings]))
    own = jax.vmap(lambda s: motion(layout, s))(jnp.asarray(states, jnp.float32))
    velocity, position = np.asarray(own.velocity), np.asarray(own.position)
    command = _usual(commands)
    speed = np.quantile(np.abs(velocity), 0.95, axis=0)
    axes = axis_indices(layout)
    driving = [layout.command[b, a] for b, a in axes]
    axis_speed = np.array([speed[b, a] for b, a in axes])
    return Scales(
        command=command,
        command_step=np.array([_usual(c[c > 1e-9]) if (c > 1e-9).any() else TINY for c in changes.T]),
        speed=speed,
        axis_speed=axis_speed,
        axis_command=np.array([command[c] if c >= 0 else v for c, v in zip(driving, axis_speed, strict=True)]),
        reach=np.quantile(np.linalg.norm(position[:, reaching(layout), :2], axis=-1), QUANTILES, axis=0).T,
        height=np.quantile(position[:, floored(layout), 2], QUANTILES, axis=0).T,
        interval=_intervals(augmented, recordings),
        output=np.array([TINY + np.quantile(np.abs(s - np.median(s)), 0.95) for s in states.T]),
        duration=float(max(r.time_s[-1] - r.time_s[0] for r in recordings)),
        time_step=float(augmented.simulator.time_step),
    )  # fmt: skip


def _usual(values: np.ndarray) -> np.ndarray:
    return np.maximum(np.quantile(np.abs(values), 0.95, axis=0), TINY)


def _intervals(augmented: Augmented, recordings: Sequence[Recording]) -> np.ndarray:
    """Time [s] by which each position advances per unit of its new velocity, by least squares over all rows."""
    layout, schema = augmented.layout, augmented.simulator.schema
    out = np.full(len(schema.state), float(augmented.simulator.time_step))
    for i, v in enumerate(layout.integrates):
        if v < 0:
            continue
        moved = np.concatenate([np.diff(r.state[:, i]) for r in recordings])
        moved = np.arctan2(np.sin(moved), np.cos(moved)) if schema.state[i].kind == "angle" else moved
        velocity = np.concatenate([r.state[1:, v] for r in recordings])
        power = velocity @ velocity
        if power > TINY:
            out[i] = moved @ velocity / power
    return out
