"""Magnitudes of a recording set: the scales at which effects are looked for."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales, axis_indices, floored, reaching
from simgap.kinematics import motion
from simgap.types import Recording

QUANTILES = np.linspace(0, 1, 21)
STEPS = 1e-6
"""Of the greatest change of a command, below which a change is its rounding."""


def measure(augmented: Augmented, recordings: Sequence[Recording]) -> Scales:
    """Scales of all sessions together."""
    layout = augmented.layout
    states = np.concatenate([r.state for r in recordings])
    commands = np.concatenate([r.command for r in recordings])
    changes = np.abs(np.concatenate([np.diff(r.command, axis=0) for r in recordings]))
    own = jax.vmap(lambda s: motion(layout, s))(jnp.asarray(states, jnp.float32))
    velocity, position = np.asarray(own.velocity), np.asarray(own.position)
    b, a = np.array(axis_indices(layout), int).reshape(-1, 2).T
    return Scales(
        command=_usual(commands),
        command_step=np.array([_usual(c[c > STEPS * c.max(initial=0.0), None])[0] for c in changes.T]),
        speed=np.quantile(np.abs(velocity), 0.95, axis=0),
        axis_speed=_usual(velocity[:, b, a]),
        axis_command=_axis_commands(augmented, recordings, commands, velocity),
        reach=np.quantile(np.linalg.norm(position[:, reaching(layout), :2], axis=-1), QUANTILES, axis=0).T,
        height=np.quantile(position[:, floored(layout), 2], QUANTILES, axis=0).T,
        interval=_intervals(augmented, recordings),
        output=_usual(states - np.median(states, axis=0)),
        duration=float(max(r.time_s[-1] - r.time_s[0] for r in recordings)),
        time_step=float(augmented.simulator.time_step),
    )


def _usual(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " k"]:
    """Of every column the 95th percentile of the size; the greatest size, where most is zero; 1, where all is."""
    size = np.abs(values)
    usual = np.quantile(size, 0.95, axis=0) if len(size) else np.zeros(size.shape[1])
    usual = np.where(usual > 0, usual, size.max(0, initial=0.0))
    return np.where(usual > 0, usual, 1.0)


def _axis_commands(
    augmented: Augmented,
    recordings: Sequence[Recording],
    commands: Float[np.ndarray, "n u"],
    velocity: Float[np.ndarray, "n b 4"],
) -> Float[np.ndarray, " k"]:
    """Usual commands of the axes that can be pushed; the usual velocity where there is none.

    A command that is always zero has no size: the one then that would change the velocity by as much as it changes.
    """
    layout, simulator = augmented.layout, augmented.simulator
    ends = np.cumsum([len(r.time_s) for r in recordings])[:-1]
    changes = np.concatenate([np.diff(part, axis=0) for part in np.split(velocity, ends)])
    rest = jnp.zeros(len(layout.schema.state)), jnp.zeros(commands.shape[1])
    response = np.asarray(jax.jacfwd(lambda u: simulator.step(jnp.asarray(augmented.nominal), rest[0], u))(rest[1]))
    sizes = []
    for b, a in axis_indices(layout):
        column = layout.command[b, a]
        if column >= 0 and commands[:, column].any():
            sizes.append(_usual(commands[:, [column]])[0])
            continue
        per_unit = abs(float(response[layout.velocity[b, a], column])) if column >= 0 else 0.0
        if np.isfinite(per_unit) and per_unit > 0:
            sizes.append(_usual(changes[:, b, a][:, None])[0] / per_unit)
        else:
            sizes.append(_usual(velocity[:, b, a][:, None])[0])
    return np.array(sizes)


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
        if power > 0:
            out[i] = moved @ velocity / power
    return out
