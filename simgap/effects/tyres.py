"""Tyres that slip: a car does not move where its wheels point. Place "after":
`law(c[k, sites], state, then, layout, scales, row) -> then`.

A simulator that lacks this moves along its heading, and turns as its wheels roll. Tyres give a lateral force only by
slipping, the more the larger it is, and it grows with the speed times the yaw rate [Milliken and Milliken 1995, ch. 5].
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Row, Scales, Site
from simgap.kinematics import placed, wrapped
from simgap.layout import YAW, Layout, X, Y

_S = Float[Array, " s"]


def wheeled(layout: Layout) -> list[int]:
    """Bodies with a pose in the plane that move along their heading: with a speed ahead, and no velocity or command
    sideways."""

    def steers(b: int) -> bool:
        sideways = max(layout.velocity[b, Y], layout.driven[b, Y])
        free = layout.carrier[b] is None and layout.in_world("position", b)
        return bool(free and sideways < 0 <= min(*layout.position[b, [X, Y, YAW]], layout.velocity[b, X]))

    return [b for b in range(len(layout.bodies)) if steers(b)]


def _site(layout: Layout, b: int, axes: list[int]) -> Site:
    names = tuple(layout.schema.state[i].name for i in layout.position[b, axes])
    return Site(layout.bodies[b], (), names, layout.bodies[b], "m/s")


def _sideways(c: Float[Array, "1 n"], state: _S, then: _S, layout: Layout, scales: Scales, row: Row) -> _S:
    """A lateral velocity of -c v w: the body moves outwards in a bend."""
    moved = wrapped(layout, then - state)
    for k, b in enumerate(wheeled(layout)):
        x, y, yaw, v = *layout.position[b, [X, Y, YAW]], layout.velocity[b, X]
        heading = state[yaw] + moved[yaw] / 2
        outwards = c[0, k] * (state[v] + then[v]) / 2 * moved[yaw]
        then = (
            then + placed(len(then), x, outwards * jnp.sin(heading)) - placed(len(then), y, outwards * jnp.cos(heading))
        )
    return then


def _less_turning(c: Float[Array, "1 n"], state: _S, then: _S, layout: Layout, scales: Scales, row: Row) -> _S:
    """w / (1 + c v^2): the yaw rate of a car that understeers. Its path bends less as well."""
    moved = wrapped(layout, then - state)
    for k, b in enumerate(wheeled(layout)):
        x, y, yaw, v = *layout.position[b, [X, Y, YAW]], layout.velocity[b, X]
        square = c[0, k] * ((state[v] + then[v]) / 2) ** 2
        lost = -moved[yaw] * square / (1 + square)
        # The chord of an arc turns by half as much as the body.
        sine, cosine = jnp.sin(lost / 2), jnp.cos(lost / 2)
        dx, dy = moved[x], moved[y]
        then = then + placed(len(then), yaw, lost)
        then = (
            then
            + placed(len(then), x, cosine * dx - sine * dy - dx)
            + placed(len(then), y, sine * dx + cosine * dy - dy)
        )
    return then


def _sites(axes: list[int]):
    return lambda layout: tuple(_site(layout, b, axes) for b in wheeled(layout))


def _slips(scales: Scales, site: int) -> list[list[float]]:
    """A tenth of a radian of slip at a yaw rate of one."""
    return [[0.1]]


def _understeers(scales: Scales, site: int) -> list[list[float]]:
    """At the usual speed a tenth of the yaw rate is lost."""
    return [[0.1 / (float(scales.speed[:, X].max()) or 1.0) ** 2]]


EFFECTS = (
    Effect(
        "tyre_slip", "after", (Constant("slip", "rad per rad/s", low=0.0),), _sites([X, Y]), _slips, _sideways,
        "tyre slip: in bends the body slides outwards, by {slip} times the yaw rate", form="sideways", bends=("speed",),
    ),
    Effect(
        "tyre_slip", "after", (Constant("understeer", "s^2/m^2", low=0.0),), _sites([X, Y, YAW]), _understeers,
        _less_turning, "tyre slip: fast bends are wider, the yaw rate is over 1 + {understeer} times the squared speed",
        form="turning", bends=("speed",),
    ),
)  # fmt: skip
