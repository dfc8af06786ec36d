"""Springs and weight of bodies that keep their place: carts on a rail, joints, pendulums.

Such a body has one axis only, along which its position is known. `law(c[k, sites], step) -> push[b, 4]`.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Scales, Site, Step
from simgap.effects.sites import axis_indices, axis_sites, on_axes
from simgap.kinematics import wrapped
from simgap.layout import Layout


def staying(layout: Layout) -> list[tuple[int, int]]:
    """Those of `axis_indices` whose body has no other axis, and a known position. It is driven, or the position is one
    within the machine: what falls through the world is tied to no place. An engine's joints have terms instead."""

    def stays(b: int, a: int) -> bool:
        held = layout.driven[b, a] >= 0 or layout.schema.state[layout.position[b, a]].frame == "body"
        return held and layout.single(b) and layout.bodies[b] not in layout.joints

    return [(b, a) for b, a in axis_indices(layout) if layout.position[b, a] >= 0 and stays(b, a)]


def _turning(layout: Layout) -> list[tuple[int, int]]:
    """Those whose position is an angle."""
    return [(b, a) for b, a in staying(layout) if layout.schema.state[layout.position[b, a]].unit == "rad"]


def staying_sites(layout: Layout) -> tuple[Site, ...]:
    """Sites at those of `staying`."""
    return _sites_at(layout, staying(layout))


def _turning_sites(layout: Layout) -> tuple[Site, ...]:
    return _sites_at(layout, _turning(layout))


def _sites_at(layout: Layout, axes: list[tuple[int, int]]) -> tuple[Site, ...]:
    return tuple(
        site._replace(length=layout.schema.state[layout.position[b, a]].unit)
        for site, (b, a) in zip(axis_sites(layout), axis_indices(layout), strict=True)
        if (b, a) in axes
    )


def halfway(step: Step) -> Float[Array, "b 4"]:
    """Positions in the middle of the step: a push is constant over the row, in which a stiff spring may turn round."""
    now, then = step.states
    state = now + wrapped(step.layout, then - now) / 2
    columns = [step.layout.position[place] for place in staying(step.layout)]
    return on_axes(step.layout, [state[i] for i in columns], staying(step.layout))


def _spring(c: Float[Array, "2 n"], step: Step) -> Float[Array, "b 4"]:
    """-c_0 x - c_1 x^3."""
    linear, cubic = (on_axes(step.layout, values, staying(step.layout)) for values in c)
    x = halfway(step)
    return -linear * x - cubic * x**3


def _weight(c: Float[Array, "2 n"], step: Step) -> Float[Array, "b 4"]:
    """-c_0 sin(q - c_1)."""
    moment, hanging = (on_axes(step.layout, values, _turning(step.layout)) for values in c)
    return -moment * jnp.sin(halfway(step) - hanging)


def _springs(scales: Scales, site: int) -> list[list[float]]:
    """At the usual distance either term amounts to a tenth of the usual command."""
    push, far = 0.1 * float(scales.hold[site]), float(scales.travel[site])
    return [[push / far, push / far**3]]


def _weights(scales: Scales, site: int) -> list[list[float]]:
    """Hanging in any direction, in steps of 60 degrees; the fit starts from the nearest."""
    return [[0.1 * float(scales.hold.max()), k * math.pi / 3] for k in range(-2, 4)]


EFFECTS = (
    Effect(
        "nonlinear_spring", "push", (Constant("stiffness", "{u}/{x}"), Constant("cubic", "{u}/{x}^3")),
        staying_sites, _springs, _spring,
        "a spring pulls back by {stiffness} times the displacement, and {cubic} times its cube",
        tie="same_unit", bends=("place",),
    ),
    Effect(
        "joint_gravity", "push", (Constant("moment", "{u}", low=0.0), Constant("hanging", "rad", shapes=True)),
        _turning_sites, _weights, _weight,
        "a weight turns the joint: a moment of up to {moment} towards {hanging}, where it hangs",
        bends=("place",),
    ),
)  # fmt: skip
