"""Resistances that grow with the speed: pushes against a body's own motion, in the command's unit.

`law(c[k, sites], step) -> push[b, 4]`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Scales, Step
from simgap.effects.sites import axis_sites, body_sites, on_axes, turning
from simgap.kinematics import on_body
from simgap.layout import YAW, X, Y


def _viscous(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """-c v."""
    return -on_axes(step.layout, c[0]) * step.now.velocity


def _quadratic(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """-c v |v|."""
    return -on_axes(step.layout, c[0]) * step.now.velocity * jnp.abs(step.now.velocity)


def _slip_turning(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """-c |w| v along x and y."""
    out = jnp.zeros_like(step.now.velocity)
    for k, b in enumerate(turning(step.layout)):
        v = step.now.velocity[b]
        out = out - on_body(step.layout, b, X, c[0, k] * jnp.abs(v[YAW]) * v[:2])
    return out


def _slip_walking(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """-c |v_xy| w."""
    out = jnp.zeros_like(step.now.velocity)
    for k, b in enumerate(turning(step.layout)):
        v = step.now.velocity[b]
        out = out - on_body(step.layout, b, YAW, c[0, k] * speed(v) * v[YAW])
    return out


def speed(v: Float[Array, " 4"]) -> Float[Array, ""]:
    """Horizontal speed, differentiable at rest."""
    return jnp.sqrt(v[X] ** 2 + v[Y] ** 2 + 1e-8)


def _bodies(axes: tuple[int, ...]):
    return lambda layout: body_sites(layout, turning(layout), axes)


def _small(fraction: float, power: int):
    """Starting value: the resistance at the axis' usual speed is a fraction of its usual command."""

    def starts(scales: Scales, site: int) -> list[list[float]]:
        return [[fraction * float(scales.axis_command[site]) / float(scales.axis_speed[site]) ** power]]

    return starts


EFFECTS = (
    Effect(
        "viscous_drag", "push", (Constant("coefficient", "-", low=0.0),), axis_sites, _small(0.1, 1), _viscous,
        "viscous drag: a resistance of {coefficient} times the speed works against the motion", tie="any",
    ),
    Effect(
        "quadratic_drag", "push", (Constant("coefficient", "s/m", low=0.0),), axis_sites, _small(0.1, 2), _quadratic,
        "drag grows with the square of the speed, with coefficient {coefficient}",
        tie="same_unit",
    ),
    Effect(
        "slip", "push", (Constant("loss", "per rad/s", low=0.0),), _bodies((X, Y)),
        lambda scales, site: [[0.1]], _slip_turning,
        "slip: the feet lose ground when turning, {loss} of the speed", form="turning",
    ),
    Effect(
        "slip", "push", (Constant("loss", "per m/s", low=0.0),), _bodies((YAW,)),
        lambda scales, site: [[0.1]], _slip_walking,
        "slip: turning loses grip when walking fast, {loss} of the yaw rate", form="walking",
    ),
)  # fmt: skip
