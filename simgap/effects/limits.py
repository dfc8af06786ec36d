"""Limits on where a body can go."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Scales, Site, Step, reciprocal
from simgap.effects.sites import body_sites, floored, reaching
from simgap.kinematics import commanded, on_body, substituted
from simgap.layout import Layout, X, Y, Z

FURTHER = (0.15, 0.3, 0.5, 0.75)
"""Starting values of a limit that few rows reach: shares of the way from the usual reach to the largest."""
SOFT = 0.02
"""Share of the reach over which commands fade out at the limit, so that the law is differentiable."""


def _outward(axes: int):
    def law(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
        """Cancels the outward part of the command where the distance exceeds 1/c."""
        out = jnp.zeros_like(step.now.velocity)
        for k, b in enumerate(reaching(step.layout)):
            arm = step.now.position[b, :axes]
            distance = jnp.sqrt(arm @ arm + 1e-8)
            u = commanded(step.layout, b, step.now.heading[b], step.command)[:axes]
            beyond = jnp.clip((distance * c[0, k] - 1) / SOFT + 0.5, 0.0, 1.0)
            out = out - on_body(step.layout, b, X, beyond * jnp.maximum(u @ arm / distance, 0.0) * arm / distance)
        return out

    return law


def _reaches(scales: Scales, site: int) -> list[list[float]]:
    """Starting values at quantiles of the reach, and between the last of these and the largest, where rows are few."""
    within = [float(scales.reach[site, q]) for q in (9, 13, 16, 18, 19)]
    beyond = float(scales.reach[site, 20]) - within[-1]
    return [[1 / max(reach, 1e-3)] for reach in (*within, *(within[-1] + share * beyond for share in FURTHER))]


def _contact(
    c: Float[Array, "1 n"], state: Float[Array, " s"], then: Float[Array, " s"], layout: Layout, scales: Scales, row
) -> Float[Array, " s"]:
    """z >= `_depth` + c, and no velocity into the ground."""
    for k, b in enumerate(floored(layout)):
        z, vz = (int(table[b, Z]) for table in (layout.position, layout.velocity))
        floor = jnp.where(c[0, k] > 0, _depth(scales, k) + c[0, k], -jnp.inf)
        below = then[z] < floor
        then = substituted(then, z, jnp.maximum(then[z], floor))
        if vz >= 0:
            then = substituted(then, vz, jnp.where(below, jnp.maximum(then[vz], 0.0), then[vz]))
    return then


def _depth(scales: Scales, site: int) -> Float[np.ndarray, ""]:
    """As far below the lowest recorded height as that is below the highest: a floor there has no effect."""
    return 2 * scales.height[site, 0] - scales.height[site, -1]


def _heights(scales: Scales, site: int) -> list[list[float]]:
    lowest, above = scales.height[site, 0], scales.height[site] - scales.height[site, 0]
    near = [share * above[1] for share in (0.03, 0.1, 0.3, 0.6, 1.0)]
    return [[float(lowest - _depth(scales, site)) + max(float(c), 1e-4)] for c in (*near, above[3], above[6])]


def _floored_sites(layout: Layout) -> tuple[Site, ...]:
    names = [f.name for f in layout.schema.state]
    at = {b: [int(i) for i in (layout.velocity[b, Z], layout.position[b, Z]) if i >= 0] for b in floored(layout)}
    return tuple(Site(layout.bodies[b], (), tuple(names[i] for i in at[b]), layout.bodies[b], "m") for b in at)


def _height(c: float, site: int, scales: Scales) -> float:
    return float(_depth(scales, site)) + c


EFFECTS = (
    Effect(
        "reach_limit", "push", (Constant("reach", "m", reciprocal, 0.0),),
        lambda layout: body_sites(layout, reaching(layout), (X, Y)), _reaches, _outward(2),
        "reach limit: beyond a horizontal reach of {reach} the arm cannot follow outward commands", form="horizontal",
        bends=("place",),
    ),
    Effect(
        "reach_limit", "push", (Constant("reach", "m", reciprocal, 0.0),),
        lambda layout: body_sites(layout, reaching(layout), (X, Y, Z)),
        lambda scales, site: [[0.8 * c[0]] for c in _reaches(scales, site)], _outward(3),
        "reach limit: beyond {reach} from its carrier's origin the arm cannot follow outward commands",
        form="spherical", bends=("place",),
    ),
    Effect(
        "ground_contact", "after", (Constant("height", "m", _height, 0.0),), _floored_sites, _heights, _contact,
        "ground contact: no motion below a height of {height}",
        bends=("place",),
    ),
)  # fmt: skip
