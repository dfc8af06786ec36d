"""Loads and pushes from weight, ground and surroundings. `law(c[k, sites], step) -> push[b, 4]`."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Scales, Site, Step
from simgap.effects.resistance import speed
from simgap.effects.sites import axis_sites, body_sites, mounted, on_axes, turning
from simgap.kinematics import commanded, on_body, placed, rigid
from simgap.layout import YAW, Layout, X, Y, Z


def _lifted(layout: Layout) -> list[int]:
    """Mounted bodies with a vertical velocity: they can sink."""
    return [b for b in mounted(layout) if layout.velocity[b, Z] >= 0]


def _distance(xy: Float[Array, " 2"]) -> Float[Array, ""]:
    return jnp.sqrt(xy @ xy + 1e-8)


def _sag(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """-c r along z, where r is the horizontal reach."""
    out = jnp.zeros_like(step.now.velocity)
    for k, b in enumerate(_lifted(step.layout)):
        out = out - on_body(step.layout, b, Z, c[0, k] * _distance(step.now.position[b, :2]))
    return out


def _payload(inherited: bool):
    def law(c: Float[Array, "3 n"], step: Step) -> Float[Array, "b 4"]:
        """From the onset c_2 on: -c_0 (u - v), and -c_1 along z; v: own velocity, plus the carrier's if inherited."""
        now, layout = step.now, step.layout
        out = jnp.zeros_like(now.velocity)
        for k, b in enumerate(_lifted(layout)):
            on = jnp.clip((step.row.time_s - c[2, k]) / step.scales.time_step, 0.0, 1.0)
            u = commanded(layout, b, now.heading[b], step.command)
            u = jnp.where(layout.command[b] >= 0, u, now.velocity[b])
            v = now.velocity[b]
            if inherited:
                v = v + placed(4, X, rigid(now.velocity[layout.carrier[b]], now.position[b]))
            out = out - on_body(layout, b, X, on * c[0, k] * (u - v)) - on_body(layout, b, Z, on * c[1, k])
        return out

    return law


def _slope(c: Float[Array, "2 n"], step: Step) -> Float[Array, "b 4"]:
    """|v_xy| R(heading)^T (c_0, c_1): a pull in a fixed world direction, proportional to the walking speed."""
    out = jnp.zeros_like(step.now.velocity)
    for k, b in enumerate(turning(step.layout)):
        angle = step.now.heading[b]
        x = jnp.cos(angle) * c[0, k] + jnp.sin(angle) * c[1, k]
        y = -jnp.sin(angle) * c[0, k] + jnp.cos(angle) * c[1, k]
        out = out + on_body(step.layout, b, X, speed(step.now.velocity[b]) * jnp.stack([x, y]))
    return out


def _bias(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """A constant push c, in the body's own frame or on the joint."""
    return on_axes(step.layout, c[0])


def _external(c: Float[Array, "2 n"], step: Step) -> Float[Array, "b 4"]:
    """R(heading)^T c_0 (cos c_1, sin c_1): a push in a fixed world direction."""
    out = jnp.zeros_like(step.now.velocity)
    for k, b in enumerate(_pushable(step.layout)):
        along = c[1, k] - step.now.heading[b]
        out = out + on_body(step.layout, b, X, c[0, k] * jnp.stack([jnp.cos(along), jnp.sin(along)]))
    return out


def _axes_of_bodies(layout: Layout) -> tuple[Site, ...]:
    return () if layout.jointed else axis_sites(layout)


def _axes_of_joints(layout: Layout) -> tuple[Site, ...]:
    return axis_sites(layout) if layout.jointed else ()


def _pushable(layout: Layout) -> list[int]:
    """Bodies whose velocities along x and y are known."""
    return [b for b in range(len(layout.bodies)) if all(layout.velocity[b, [X, Y]] >= 0)]


def _pushable_sites(layout: Layout) -> tuple[Site, ...]:
    return body_sites(layout, _pushable(layout), (X, Y))


def _directions(scales: Scales, site: int) -> list[list[float]]:
    """Directions all round, in steps of 60 degrees; the fit starts from the nearest."""
    return [[0.1, k * math.pi / 3] for k in range(-2, 4)]


def _fraction_of_command(fraction: float):
    return lambda scales, site: [[fraction * float(scales.axis_command[site])]]


def _onsets(scales: Scales, site: int) -> list[list[float]]:
    return [[0.2, 0.05, share * scales.duration] for share in (0.1, 0.3, 0.5, 0.7, 0.9)]


def _lifted_sites(axes: tuple[int, ...]):
    return lambda layout: body_sites(layout, _lifted(layout), axes)


def _ground_sites(layout: Layout) -> tuple[Site, ...]:
    return body_sites(layout, turning(layout), (X, Y))


_PAYLOAD = (
    Constant("added memory", "-", low=0.0, high=0.95),
    Constant("sink", "m/s", low=0.0),
    Constant("onset", "s", low=0.0, shapes=True),
)

EFFECTS = (
    Effect(
        "gravity_sag", "push", (Constant("sink per reach", "1/s", low=0.0),), _lifted_sites((Z,)),
        lambda scales, site: [[0.05]], _sag,
        "the arm sags under its own weight: it sinks by {sink per reach} times its reach",
        bends=("place",),
    ),
    Effect(
        "payload", "push", _PAYLOAD, _lifted_sites((X, Y, Z, YAW)), _onsets, _payload(inherited=False),
        "payload: from {onset} on a load is carried; the motion answers slower (added memory {added memory}) and sinks "
        "by {sink}", form="own_motion", bends=("place",),
    ),
    Effect(
        "payload", "push", _PAYLOAD, _lifted_sites((X, Y, Z, YAW)), _onsets, _payload(inherited=True),
        "payload: from {onset} on a load is carried, and its velocity in the world is remembered longer (added memory "
        "{added memory}); it sinks by {sink}", form="inherited", bends=("place",),
    ),
    Effect(
        "slope", "push",
        (Constant("pull x", "-", low=-1.0, high=1.0), Constant("pull y", "-", low=-1.0, high=1.0)), _ground_sites,
        lambda scales, site: [[0.05, 0.05]], _slope,
        "tilted ground pulls by ({pull x}, {pull y}) of the walking speed in the world's x and y",
        bends=("place",),
    ),
    Effect(
        "body_frame_bias", "push", (Constant("drift", "{u}"),), _axes_of_bodies, _fraction_of_command(0.05), _bias,
        "a steady drift of {drift} in the robot's own frame",
        bends=("place",),
    ),
    Effect(
        "constant_load", "push", (Constant("load", "{u}"),), _axes_of_joints, _fraction_of_command(0.05), _bias,
        "a constant load of {load} acts on the joint",
        bends=("place",),
    ),
    Effect(
        "external_push", "push", (Constant("velocity", "{u}", low=0.0), Constant("direction", "rad", shapes=True)),
        _pushable_sites, _directions, _external,
        "a disturbance from outside pushes by {velocity} towards {direction} in the world", event=True,
        form="world_frame", bends=("place",),
    ),
    Effect(
        "external_push", "push", (Constant("velocity", "{u}"),), _axes_of_bodies, _fraction_of_command(0.2), _bias,
        "a disturbance from outside pushes by {velocity} along the robot's own axis", event=True, form="own_frame",
        bends=("place",),
    ),
    Effect(
        "external_push", "push", (Constant("load", "{u}"),), _axes_of_joints, _fraction_of_command(0.2), _bias,
        "a disturbance from outside pushes the joint by {load}", event=True, form="on_joint", bends=("place",),
    ),
)  # fmt: skip
