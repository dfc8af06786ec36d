"""Dry friction: a push against the motion that holds a body at rest. `law(c[k, sites], step) -> most[b, 4]`.

A law says how large the friction is at most; what several allow adds up to one friction. All but Coulomb's are of
bodies that keep their place (`restoring.staying`).
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Scales, Site, Step
from simgap.effects.restoring import halfway, staying, staying_sites
from simgap.effects.sites import axis_sites, on_axes
from simgap.layout import Layout

SLOW = (0.03, 0.1, 0.3)
"""Starting values of a speed below which friction rises, as shares of the usual speed."""


def opposed(ending: Float[Array, "b 4"], most: Float[Array, "b 4"]) -> Float[Array, "b 4"]:
    """A push of size `most` against the motion, or the smaller push `ending`, which ends it: the body sticks."""
    return jnp.clip(ending, -most, most)


def _coulomb(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """c."""
    return on_axes(step.layout, c[0])


def _stribeck(c: Float[Array, "3 n"], step: Step) -> Float[Array, "b 4"]:
    """c_0 + c_1 exp(-(v / c_2)^2) [Armstrong-Helouvry 1994]."""
    sliding, excess, slow = (on_axes(step.layout, values, staying(step.layout)) for values in c)
    share = step.now.velocity / jnp.where(slow > 0, slow, jnp.inf)
    return sliding + excess * jnp.exp(-(share**2))


def _under_load(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """c |load|; the load is the force that is commanded, or how far the motion is from the commanded one."""
    layout, at = step.layout, {"position": halfway(step), "velocity": step.now.velocity}
    loads = []
    for b, a in _driven(layout):
        column = layout.driven[b, a]
        kind = layout.schema.command[column].kind
        loads.append(step.command[column] - (at[kind][b, a] if kind in at else 0.0))
    return jnp.abs(on_axes(layout, c[0] * jnp.stack(loads), _driven(layout)))


def _driven(layout: Layout) -> list[tuple[int, int]]:
    return [place for place in staying(layout) if layout.driven[place] >= 0]


def _driven_sites(layout: Layout) -> tuple[Site, ...]:
    return tuple(site for site in staying_sites(layout) if site.channels)


def _usual_command(site: int, scales: Scales) -> float:
    """With a greater loss, hardly any command would move the axis."""
    return float(scales.axis_command[site])


def _stribecks(scales: Scales, site: int) -> list[list[float]]:
    loss = 0.1 * float(scales.hold[site])
    return [[loss, loss, share * float(scales.pace[site])] for share in SLOW]


EFFECTS = (
    Effect(
        "coulomb_friction", "friction", (Constant("loss", "{u}", low=0.0, credible=_usual_command),), axis_sites,
        lambda scales, site: [[0.1 * float(scales.axis_command[site])]], _coulomb,
        "dry friction: a constant resistance of {loss} works against the motion", tie="same_unit",
    ),
    Effect(
        "stribeck_friction", "friction",
        (
            Constant("sliding loss", "{u}", low=0.0),
            Constant("static excess", "{u}", low=0.0),
            Constant("speed", "{x}/s", low=0.0, shapes=True, credible=lambda site, scales: float(scales.pace[site])),
        ),
        staying_sites, _stribecks, _stribeck,
        "dry friction of {sliding loss} works against the motion, and {static excess} more near rest, up to about "
        "{speed}", tie="same_unit", extends="coulomb_friction",
    ),
    Effect(
        "load_friction", "friction", (Constant("ratio", "-", low=0.0, high=0.95),), _driven_sites,
        lambda scales, site: [[0.1]], _under_load,
        "dry friction in proportion to the load works against the motion: {ratio} of it", tie="any",
    ),
)  # fmt: skip
