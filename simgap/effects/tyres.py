"""Tyres that slip: a car does not move where its wheels point. Place "after":
`law(c[k, sites], state, then, layout, scales, row) -> then`.

A simulator that lacks this moves along its heading, and turns as its wheels roll. Tyres give a lateral force only by
slipping. The force, and the slip with it, grows with speed times yaw rate [Milliken and Milliken 1995, ch. 5].
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Row, Scales, Site
from simgap.kinematics import placed, turn, wrapped
from simgap.layout import YAW, Layout, X, Y

_S = Float[Array, " s"]
_Number = Float[Array, ""] | float


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


def _moved(layout: Layout, b: int, then: _S, dx: _Number, dy: _Number) -> _S:
    """The state with a body displaced in the world."""
    x, y = layout.position[b, [X, Y]]
    return then + placed(len(then), x, dx) + placed(len(then), y, dy)


def _sideways(c: Float[Array, "1 n"], state: _S, then: _S, layout: Layout, scales: Scales, row: Row) -> _S:
    """A lateral velocity of -c v w: the body moves outwards in a bend."""
    step = wrapped(layout, then - state)
    for k, b in enumerate(wheeled(layout)):
        yaw, v = layout.position[b, YAW], layout.velocity[b, X]
        aside = -c[0, k] * (state[v] + then[v]) / 2 * step[yaw]
        then = _moved(layout, b, then, *turn(jnp.zeros(()), aside, state[yaw] + step[yaw] / 2))
    return then


def _less_turning(c: Float[Array, "1 n"], state: _S, then: _S, layout: Layout, scales: Scales, row: Row) -> _S:
    """w / (1 + c v^2): the yaw rate of a car that understeers. Its path bends less as well."""
    step = wrapped(layout, then - state)
    for k, b in enumerate(wheeled(layout)):
        x, y, yaw, v = *layout.position[b, [X, Y, YAW]], layout.velocity[b, X]
        square = c[0, k] * ((state[v] + then[v]) / 2) ** 2
        lost = -step[yaw] * square / (1 + square)
        # The chord of an arc turns by half as much as the body.
        dx, dy = turn(step[x], step[y], lost / 2)
        then = _moved(layout, b, then + placed(len(then), yaw, lost), dx - step[x], dy - step[y])
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
        _less_turning,
        "tyre slip: fast bends are wider, the yaw rate is divided by 1 + {understeer} times the squared speed",
        form="turning", bends=("speed",),
    ),
)  # fmt: skip
