"""Velocities that cannot be the rates of their positions, whatever the simulator's parameters are."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from simgap.effects.augmented import Augmented
from simgap.engines import Engine, is_engine
from simgap.kinematics import wrapped
from simgap.survey import OFF, Kinematics, kinematics
from simgap.types import Recording, StepModel

ROWS = 200
"""Rows from which a simulator is stepped."""


def in_other_units(simulator: StepModel | Engine, recordings: Sequence[Recording]) -> dict[str, Kinematics]:
    """The velocities that cannot be the rates of their positions, by name.

    A simulator in JAX may have a parameter for that factor (gamma, in SIM-MODEL): what its ranges allow is no matter
    of units.
    """
    found = kinematics(simulator.schema.measured, recordings)
    found = {velocity: k for velocity, k in found.items() if k.in_other_units}
    if not found or is_engine(simulator):
        return found
    slopes = _slopes(simulator, recordings, found)
    return {v: k for v, k in found.items() if not min(slopes[v]) / OFF < k.slope < OFF * max(slopes[v])}


def _slopes(
    simulator: StepModel, recordings: Sequence[Recording], found: dict[str, Kinematics]
) -> dict[str, Float[np.ndarray, " m"]]:
    """By velocity: how many times as fast as it says its position changes, in the simulator with its nominal
    parameters, and with each of them at either end of its range; and once, as where units are right."""
    schema, augmented = simulator.schema, Augmented(simulator)
    ends = [augmented.nominal + np.diag(end - augmented.nominal) for end in augmented.ranges]
    params = np.concatenate([augmented.nominal[None], *ends])
    rows = np.linspace(0, sum(len(r.time_s) for r in recordings) - 1, ROWS).astype(int)
    state, command = (
        np.concatenate(columns)[rows] for columns in zip(*((r.state, r.command) for r in recordings), strict=True)
    )
    state = jnp.pad(state, ((0, 0), (0, len(schema.state) - state.shape[1])))  # states that are not measured
    step = jax.vmap(jax.vmap(simulator.step, (None, 0, 0)), (0, None, None))
    then = step(jnp.asarray(params), state, jnp.asarray(command))
    moved, said = wrapped(augmented.layout, then - state) / simulator.time_step, (then + state) / 2
    names, slopes = [f.name for f in schema.state], {}
    for velocity, k in found.items():
        i, j = names.index(velocity), names.index(k.position)
        slope = np.asarray((said[..., i] * moved[..., j]).sum(1) / (said[..., i] ** 2).sum(1))
        slopes[velocity] = np.append(slope[np.isfinite(slope)], 1.0)
    return slopes
