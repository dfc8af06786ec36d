"""Magnitudes of a recording set: the scales at which effects are searched."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.diagnosis.likelihood.ways import noise_of
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales
from simgap.effects.restoring import staying
from simgap.effects.sites import axis_indices, floored, reaching
from simgap.effects.stepping import efforts
from simgap.effects.stops import limited, stopping
from simgap.engines import Engine, is_engine
from simgap.kinematics import motion
from simgap.rows import by_row
from simgap.simulators.tables import Points, by_effort
from simgap.types import Recording, StepModel

QUANTILES = np.linspace(0, 1, 21)
PROBES = 200
"""Rows at which the response of a joint to an effort is probed."""
STEPS = 1e-6
"""Changes of a command below this share of its greatest change count as rounding."""


def measure(augmented: Augmented, recordings: Sequence[Recording]) -> Scales:
    """Scales over all sessions."""
    layout = augmented.layout
    states = np.concatenate([r.state for r in recordings])
    commands = np.concatenate([r.command for r in recordings])
    changes = np.abs(np.concatenate([np.diff(r.command, axis=0) for r in recordings]))
    velocity, position, _ = by_row(motion, layout, states)
    b, a = np.array(axis_indices(layout), int).reshape(-1, 2).T
    held, places = staying(layout), list(zip(b.tolist(), a.tolist(), strict=True))
    axis_command = _axis_commands(augmented, recordings, commands, velocity)
    axis_speed = _typical_size(velocity[:, b, a])
    of_held = [places.index(place) for place in held]
    return Scales(
        command=_typical_size(commands),
        command_step=np.array([_typical_size(c[c > STEPS * c.max(initial=0.0), None])[0] for c in changes.T]),
        speed=np.quantile(np.abs(velocity), 0.95, axis=0),
        axis_speed=axis_speed,
        axis_command=axis_command,
        reach=np.quantile(np.linalg.norm(position[:, reaching(layout), :2], axis=-1), QUANTILES, axis=0).T,
        height=np.quantile(position[:, floored(layout), 2], QUANTILES, axis=0).T,
        interval=_intervals(augmented, recordings),
        output=_typical_size(states - np.median(states, axis=0)),
        duration=float(max(r.time_s[-1] - r.time_s[0] for r in recordings)),
        time_step=float(augmented.simulator.time_step),
        travel=_typical_size(states[:, [layout.position[place] for place in held]]),
        pace=axis_speed[of_held],
        hold=axis_command[of_held],
        grain=_grains(recordings, [int(layout.position[place]) for place in held]),
        furthest=np.abs(states[:, limited(layout)]).max(0),
        measured=float(len(stopping(layout))),
        both_ways=((commands > 0).any(0) & (commands < 0).any(0)).astype(float),
    )


def _grains(recordings: Sequence[Recording], columns: list[int]) -> Float[np.ndarray, " n"]:
    """Noise of some columns, or their least step where that is larger."""
    states = [r.state[:, columns] for r in recordings]
    steps = np.abs(np.concatenate([np.diff(state, axis=0) for state in states]))
    least = np.where(steps > 0, steps, np.inf).min(0, initial=np.inf)
    return np.maximum(noise_of(states), np.where(np.isfinite(least), least, 0.0))


def _typical_size(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " k"]:
    """95th percentile of each column's absolute values; their maximum where that is zero; 1 where all are zero."""
    size = np.abs(values)
    typical = np.quantile(size, 0.95, axis=0) if len(size) else np.zeros(size.shape[1])
    typical = np.where(typical > 0, typical, size.max(0, initial=0.0))
    return np.where(typical > 0, typical, 1.0)


def _axis_commands(
    augmented: Augmented,
    recordings: Sequence[Recording],
    commands: Float[np.ndarray, "n u"],
    velocity: Float[np.ndarray, "n b 4"],
) -> Float[np.ndarray, " k"]:
    """Typical commands of the axes that can be pushed; the typical velocity of an axis without a command.

    For a command that is always zero: the size that would cause the typical change of the velocity.
    """
    layout = augmented.layout
    ends = np.cumsum([len(r.time_s) for r in recordings])[:-1]
    changes = np.concatenate([np.diff(part, axis=0) for part in np.split(velocity, ends)])
    if is_engine(augmented.simulator):
        return _typical_efforts(augmented.simulator, augmented, recordings, changes)
    response = np.asarray(_response(augmented.simulator, jnp.asarray(augmented.nominal)))
    sizes = []
    for b, a in axis_indices(layout):
        column = layout.command[b, a]
        if column >= 0 and commands[:, column].any():
            sizes.append(_typical_size(commands[:, [column]])[0])
            continue
        per_unit = abs(float(response[layout.velocity[b, a], column])) if column >= 0 else 0.0
        if np.isfinite(per_unit) and per_unit > 0:
            sizes.append(_typical_size(changes[:, b, a][:, None])[0] / per_unit)
        else:
            sizes.append(_typical_size(velocity[:, b, a][:, None])[0])
    return np.array(sizes)


@partial(jax.jit, static_argnames="simulator")
def _response(simulator: StepModel, phi: Float[Array, " p"]) -> Float[Array, "s u"]:
    """Derivatives of the next state with respect to the commands, at rest."""
    rest, still = jnp.zeros(len(simulator.schema.state)), jnp.zeros(len(simulator.schema.command))
    return jax.jacfwd(lambda u: simulator.step(phi, rest, u))(still)


def _typical_efforts(
    engine: Engine,
    augmented: Augmented,
    recordings: Sequence[Recording],
    changes: Float[np.ndarray, "m b 4"],
) -> Float[np.ndarray, " k"]:
    """Efforts that would cause the typical velocity changes of an engine's joints."""
    states = np.concatenate([r.state for r in recordings])
    commands = np.concatenate([r.command for r in recordings])
    chosen = np.linspace(0, len(states) - 1, min(PROBES, len(states))).astype(int)
    held = np.repeat(commands[chosen, None], engine.parts, axis=1)
    points = Points(augmented.nominal.astype(float), np.zeros((len(chosen), len(engine.terms))), states[chosen], held)
    places, sizes = efforts(augmented.layout), {}
    then = engine.rows(*points, np.zeros((len(chosen), len(places))))
    for i, (b, a) in enumerate(places):
        response = by_effort(engine, points, then, i)
        slope = np.abs(response[:, augmented.layout.velocity[b, a]])
        per_unit = float(np.median(slope[np.isfinite(slope)])) if np.isfinite(slope).any() else 0.0
        sizes[b, a] = _typical_size(changes[:, b, a][:, None])[0] / per_unit if per_unit > 0 else 1.0
    return np.array([sizes[place] for place in axis_indices(augmented.layout)])


def _intervals(augmented: Augmented, recordings: Sequence[Recording]) -> np.ndarray:
    """Time [s] over which each position integrates its new velocity, by least squares over all rows."""
    layout, schema = augmented.layout, augmented.simulator.schema
    out = np.full(len(schema.state), float(augmented.simulator.time_step))
    for i, v in enumerate(layout.integrates):
        if v < 0:
            continue
        increment = np.concatenate([np.diff(r.state[:, i]) for r in recordings])
        increment = np.arctan2(np.sin(increment), np.cos(increment)) if schema.state[i].kind == "angle" else increment
        velocity = np.concatenate([r.state[1:, v] for r in recordings])
        power = velocity @ velocity
        if power > 0:
            out[i] = increment @ velocity / power
    return out
