"""Recordings of a Spot with physics that the vocabulary has no word for."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from planted import PHI, PROCESS, SENSOR
from small import ROWS, SESSIONS

from simgap.robots import operator
from simgap.simulators.spot import Spot
from simgap.types import Parameter, Recording

SPOT = Spot(parameters=tuple(
    Parameter(p.name, p.unit, p.low, p.high, float(nominal))
    for p, nominal in zip(Spot().parameters, PHI, strict=True)
))  # fmt: skip
"""As it is: with the parameters that the recordings are made with."""


def by_heading(state: jax.Array) -> jax.Array:
    """The hand drifts along the world's x, by 0.4 sin(3 yaw) of the base's speed."""
    drift = 0.4 * jnp.sin(3 * state[2]) * jnp.sqrt(state[3] ** 2 + state[4] ** 2 + 1e-8)
    return jnp.zeros(12).at[9].set(drift)


def by_speed_and_turn(state: jax.Array) -> jax.Array:
    """The hand is lifted by the base's speed forward times its yaw rate."""
    forward = jnp.cos(state[2]) * state[3] + jnp.sin(state[2]) * state[4]
    return jnp.zeros(12).at[11].set(0.6 * forward * state[5])


def unheard(law: Callable[[jax.Array], jax.Array], seed: int) -> list[Recording]:
    """Sessions of an operated Spot to whose velocities a law adds, and to its positions their integral."""

    def row(carry, key):
        state, op = carry
        k1, k2, k3 = jax.random.split(key, 3)
        measured = state + jnp.array(SENSOR) * jax.random.normal(k1, (12,))
        op, u = operator.step(op, measured, k2, 1 / 15, operator.OperatorConfig())
        more = law(state)
        state = SPOT.step(jnp.asarray(PHI), state, u) + more + jnp.roll(more, -3) / 15
        state = state + jnp.array(PROCESS) * jax.random.normal(k3, (12,))
        return (state, op), (measured, u)

    run = jax.jit(lambda state, key: jax.lax.scan(row, (state, operator.init()), jax.random.split(key, ROWS))[1])
    found = []
    for s in range(SESSIONS):
        key = jax.random.fold_in(jax.random.key(seed), s)
        y, u = run(jnp.array([0.0, 0, 0, 0, 0, 0, 0.8, 0, 0.6, 0, 0, 0]), key)
        y, u = np.array(y, np.float64), np.asarray(u, np.float64)
        y[:, 2] = np.arctan2(np.sin(y[:, 2]), np.cos(y[:, 2]))
        found.append(Recording(f"s{s}", np.arange(ROWS) / 15, y, u))
    return found
