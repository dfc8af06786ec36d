"""Laws of the command path that have a memory.

`law(c[k, sites], u, z, fading, span) -> (z, u)`: the new memory, and the command that acts, for a share `span` of a
row. For `fading` see `command_path`. The memory is a command, but for the resonance, which has two.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.layout import Layout
from simgap.types import StepModel

_U = Float[Array, " u"]
NEVER = 1e-6
"""Fading of a system that forgets nothing, or almost nothing."""
UNDAMPED = 0.99
"""Greatest damping ratio of a resonance."""
AT_ONCE = 4.0
"""Greatest fading: even a joint that follows almost at once takes part of a row."""


def fading_of(simulator: StepModel, layout: Layout, phi: Float[Array, " p"]) -> _U:
    """-ln a of every command [u], 1 - a the response at rest of the velocity it drives; `NEVER` if it drives none."""
    rest = jnp.zeros(len(layout.schema.state)), jnp.zeros(len(layout.schema.command))
    response = jax.jacfwd(lambda u: simulator.step(phi, rest[0], u))(rest[1])
    kept = []
    for i, field in enumerate(layout.schema.command):
        driven = layout.velocity[layout.command == i]
        follows = field.kind == "velocity" and len(driven) and driven[0] >= 0
        kept.append(1 - response[driven[0], i] if follows else 1.0)
    return jnp.clip(-jnp.log(jnp.maximum(jnp.array(kept), np.exp(-AT_ONCE))), NEVER, AT_ONCE)


def _beyond_one(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """(exp(x) - 1) / x - 1; near zero by its series, as the formula would lose digits to rounding."""
    away = jnp.where(jnp.abs(x) < 0.1, 0.1, x)
    return jnp.where(jnp.abs(x) < 0.1, x / 2 + x**2 / 6 + x**3 / 24 + x**4 / 120, jnp.expm1(away) / away - 1)


def backlash(c: Float[Array, "1 u"], u: _U, z: _U, fading: _U, span: float) -> tuple[_U, _U]:
    """Play of gap c: the command drags the output along at the ends of the gap."""
    z = jnp.clip(z, u - c[0] / 2, u + c[0] / 2)
    return z, z


def rate_limit(c: Float[Array, "1 u"], u: _U, z: _U, fading: _U, span: float) -> tuple[_U, _U]:
    """A ramp from z towards u by 1/c a row. Returns its end, and its equivalent constant command, which acts.

    Both are u minus a share of its change, so that without a limit they equal u exactly.
    """
    change = u - z
    rows = jnp.abs(change) * c[0] / span
    ended = jnp.maximum(rows, 1.0)
    missed = lambda rows: _beyond_one(fading * rows) / jnp.expm1(fading)  # noqa: E731 # by a ramp that ends within the row
    share = jnp.where(rows < 1, missed(jnp.minimum(rows, 1.0)), 1 - (1 - missed(1.0)) / ended)
    return u - change * (1 - 1 / ended), u - change * share


def lag(c: Float[Array, "1 u"], u: _U, z: _U, fading: _U, span: float) -> tuple[_U, _U]:
    """First-order response with a time constant of c rows. Returns its end, and its equivalent constant command."""
    rate = span / jnp.maximum(c[0], 1e-6)
    missed = jnp.where(c[0] > 0, (1 + _beyond_one(fading - rate)) / (1 + _beyond_one(fading)), 0.0)
    return u + jnp.where(c[0] > 0, jnp.exp(-rate), 0.0) * (z - u), u - missed * (u - z)


def resonance(
    c: Float[Array, "2 u"], u: _U, z: Float[Array, "2 u"], fading: _U, span: float
) -> tuple[Float[Array, "2 u"], _U]:
    """Second-order response x'' = w^2 (u - x) - 2 d w x', with 1/w = c_0 rows and damping d = c_1 below one.

    With s = w (-d + i sqrt(1 - d^2)), x = u + Re[(1 - i d / sqrt(1 - d^2)) (z - u)], where z is a lag with the complex
    rate s, z' = s (z - u). Its real and imaginary part are the memory.
    """
    acts, damping = c[0] > 0, jnp.clip(c[1], 0.0, UNDAMPED)
    turns = jnp.sqrt(1 - damping**2)
    rate = span / jnp.where(acts, c[0], 1.0) * jax.lax.complex(damping, -turns)
    missed = _growth(fading - rate) / (1 + _beyond_one(fading))
    off = jax.lax.complex(z[0] - u, z[1])
    ended, acting = jnp.exp(-rate) * off, jax.lax.complex(jnp.ones_like(turns), -damping / turns) * off * missed
    return jnp.where(acts, jnp.stack([u + ended.real, ended.imag]), resting(u)), u + jnp.where(acts, acting.real, 0.0)


def resting(u: _U) -> Float[Array, "2 u"]:
    """The memory of a resonance once a command has lasted."""
    return jnp.stack([u, jnp.zeros_like(u)])


def _growth(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """(exp(x) - 1) / x of a complex number."""
    small = x.real**2 + x.imag**2 < 0.03**2
    away = jnp.where(small, 1.0, x)
    return jnp.where(small, 1 + x * (1 / 2 + x / 6), (jnp.exp(away) - 1) / away)
