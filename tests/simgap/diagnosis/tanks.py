"""Two made-up tanks, of which only the lower one's level is measured: the upper one's shares no axis with it."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.types import Field, Parameter, Recording, Schema, Sessions

ROWS, FINER, NOISE = 300, 20, 0.02
FIRST, EMPTY = 3.0, 1e-3
"""Both levels when a session begins; the least level, which flows as if there were that much."""
PARAMS = (0.05, 0.052, 0.055)
SCHEMA = Schema(
    (
        Field("lower", "V", "position", "world", "lower"),
        Field("upper", "V", "position", "world", "upper", observed=False),
    ),
    (Field("pump", "V", "force", "world", "upper"),),
)


@dataclass(frozen=True)
class Tanks:
    """Levels [V] of two tanks: a pump fills the upper one, which drains into the lower one."""

    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = tuple(Parameter(n, "-", 0.02, 0.12, nominal=0.05) for n in ("a", "b", "c"))
    time_step: float = 4.0

    def step(self, params: Float[Array, " 3"], state: Float[Array, " 2"], command: Float[Array, " 1"]) -> Array:
        """Four steps of the midpoint rule."""

        def rates(levels: Array) -> Array:
            upper, lower, pump = params
            out = jnp.sqrt(jnp.maximum(levels, EMPTY)) * jnp.stack([lower, upper])
            return jnp.stack([out[1] - out[0], pump * command[0] - out[1]])

        h = self.time_step / 4
        for _ in range(4):
            state = state + h * rates(state + h / 2 * rates(state))
        return state


def session(
    rng: np.random.Generator,
    params: tuple[float, ...] = PARAMS,
    noise: float = NOISE,
    upper_full: float = np.inf,
    lower_full: float = np.inf,
) -> Recording:
    """Both tanks, which may overflow, in steps far finer than a row."""
    levels, full, h, seen = np.full(2, FIRST), np.array([lower_full, upper_full]), Tanks().time_step / FINER, []
    drains, leaks, pumped = params

    def rates(levels: np.ndarray, u: float) -> np.ndarray:
        out, through = np.array([leaks, drains]) * np.sqrt(np.maximum(levels, EMPTY))
        return np.array([through - out, pumped * u - through])

    command = np.repeat(rng.uniform(0, 8.5, ROWS // 20), 20)
    for u in command:
        seen.append(levels[0])
        for _ in range(FINER):
            levels = np.minimum(levels + h * rates(levels + h / 2 * rates(levels, u), u), full)
    measured = np.array(seen)[:, None] + noise * rng.standard_normal((ROWS, 1))
    return Recording(f"session_{rng.integers(10**6)}", Tanks().time_step * np.arange(ROWS), measured, command[:, None])


def recorded(seed: int = 0, **more) -> Sessions:
    """Three sessions to fit, one held out."""
    rng = np.random.default_rng(seed)
    recordings = [session(rng, **more) for _ in range(4)]
    return Sessions(recordings[:3], recordings[3:])
