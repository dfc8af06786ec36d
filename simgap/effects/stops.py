"""Limits at which a quantity stops, or its sensor: a full tank, an end of the rail, the range of a converter.

A quantity also stops where it is not measured, as a tank does that drains into another one.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Row, Scales, Site, reciprocal
from simgap.effects.sites import output_sites
from simgap.kinematics import substituted
from simgap.layout import Layout

SHARES = (1.0, 0.99, 0.97, 0.93, 0.85, 0.7)
"""Starting values, as shares of the greatest size recorded: noise may have carried it beyond the limit."""
GUESSED = (1.0, 0.8, 0.6, 0.4, 0.3, 0.2, 0.15, 0.1)
"""The same of a quantity that is not measured: the simulator, which knows no limit, leads its guess far beyond."""


def stopping(layout: Layout) -> list[int]:
    """Outputs of bodies that move along one axis at most and on no carrier, and outputs of no body."""
    several = {
        body for b, body in enumerate(layout.bodies)
        if layout.carrier[b] is not None or ((layout.velocity[b] >= 0) | (layout.position[b] >= 0)).sum() > 1
    }  # fmt: skip
    return [i for i, f in enumerate(layout.schema.outputs) if f.body not in several]


def limited(layout: Layout) -> list[int]:
    """States that may stop: these outputs, and positions that are neither measured nor coupled with what is."""
    hidden = [i for i, f in enumerate(layout.schema.state) if layout.apart[i] and f.kind == "position"]
    return [*stopping(layout), *hidden]


def _sensor_sites(layout: Layout) -> tuple[Site, ...]:
    return tuple(output_sites(layout)[i] for i in stopping(layout))


def _quantity_sites(layout: Layout) -> tuple[Site, ...]:
    hidden = [layout.schema.state[i] for i in limited(layout)[len(stopping(layout)) :]]
    return (*_sensor_sites(layout), *(Site(f.name, (), (), f"{f.body} {f.kind}", f.unit) for f in hidden))


def _within(value: Float[Array, ""], c: Float[Array, ""]) -> Float[Array, ""]:
    """The value, no larger than 1 / c."""
    return value / jnp.maximum(1.0, jnp.abs(value) * c)


def _sensor(c: Float[Array, "1 n"], state: Array, past: Array, row: Row, layout: Layout) -> Array:
    """y within -1 / c and 1 / c."""
    for k, i in enumerate(stopping(layout)):
        state = substituted(state, i, _within(state[i], c[0, k]))
    return state


def _quantity(
    c: Float[Array, "1 n"], state: Float[Array, " s"], then: Float[Array, " s"], layout: Layout, scales: Scales, row
) -> Float[Array, " s"]:
    """x within -1 / c and 1 / c, and no velocity beyond."""
    for k, i in enumerate(limited(layout)):
        v, held = int(layout.integrates[i]), _within(then[i], c[0, k])
        if v >= 0:
            outward = jnp.sign(held) * jnp.maximum(jnp.sign(held) * then[v], 0.0)
            then = substituted(then, v, jnp.where(held == then[i], then[v], then[v] - outward))
        then = substituted(then, i, held)
    return then


def _starts(scales: Scales, site: int) -> list[list[float]]:
    shares = GUESSED if site >= scales.measured else SHARES
    return [[1 / max(share * float(scales.furthest[site]), 1e-9)] for share in shares]


_LIMIT = (Constant("limit", "{u}", reciprocal, 0.0, reciprocal=True),)

EFFECTS = (
    Effect(
        "output_limit", "after", _LIMIT, _quantity_sites, _starts, _quantity,
        "a limit: the quantity stops at {limit}", form="quantity", basins=True, bends=("place",),
    ),
    Effect(
        "output_limit", "sensing", _LIMIT, _sensor_sites, _starts, _sensor,
        "a limit: the sensor shows no more than {limit}", form="sensor", basins=True, bends=("place",),
    ),
)  # fmt: skip
