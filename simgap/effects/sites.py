"""Where effects can act: commands, axes of bodies, and bodies."""

from collections.abc import Iterable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.effects.effect import Scales, Site
from simgap.kinematics import on_body
from simgap.layout import Layout


def channel_sites(layout: Layout) -> tuple[Site, ...]:
    """Every command channel."""
    sites = []
    for i, f in enumerate(layout.schema.command):
        where = np.argwhere(layout.driven == i)
        outputs: tuple[str, ...] = ()
        if len(where):
            body, axis = map(int, where[0])
            shown = layout.outputs if layout.in_world("command", body) else layout.shown_in
            outputs = shown(body, (axis,))
        sites.append(Site(f.name, (f.name,), outputs, f.body or f.name, f.unit))
    return tuple(sites)


def output_sites(layout: Layout) -> tuple[Site, ...]:
    """Every output."""
    return tuple(
        Site(f.name, (), (f.name,), f"{f.body} {f.kind}", f.unit, "in the plane" if f.axis in ("x", "y") else "")
        for f in layout.schema.outputs
    )


def axis_sites(layout: Layout) -> tuple[Site, ...]:
    """Every (body, axis) that can be pushed, in the order of `axis_indices`."""
    sites = []
    for b, a in axis_indices(layout):
        column = layout.driven[b, a]
        channels = (layout.schema.command[column].name,) if column >= 0 else ()
        (name,) = layout.outputs(b, (a,))
        unit = layout.schema.state[layout.velocity[b, a]].effort or _unit_of_push(layout, b, a)
        sites.append(Site(name, channels, layout.shown_in(b, (a,)), layout.bodies[b], unit))
    return tuple(sites)


def _unit_of_push(layout: Layout, b: int, a: int) -> str:
    """Unit of the command in which a push enters; of the velocity, where there is none."""
    column = layout.command[b, a]
    return layout.schema.command[column].unit if column >= 0 else "rad/s" if a == 3 else "m/s"


def axis_indices(layout: Layout) -> list[tuple[int, int]]:
    """The (body, axis) pairs that can be pushed and whose velocity is known."""
    return [(b, a) for b in range(len(layout.bodies)) for a in range(4) if layout.velocity[b, a] >= 0]


def body_sites(layout: Layout, bodies: list[int], axes: tuple[int, ...]) -> tuple[Site, ...]:
    """One site per body, acting along `axes`."""
    return tuple(_body_site(layout, b, axes) for b in bodies)


def _body_site(layout: Layout, b: int, axes: tuple[int, ...]) -> Site:
    channels = tuple(layout.schema.command[int(c)].name for c in layout.command[b, list(axes)] if c >= 0)
    return Site(layout.bodies[b], channels, layout.shown_in(b, axes), layout.bodies[b], "m/s")


def mounted(layout: Layout) -> list[int]:
    """Bodies on a carrier."""
    return [b for b, c in enumerate(layout.carrier) if c is not None]


def turning(layout: Layout) -> list[int]:
    """Bodies with a yaw rate and velocities along x and y, not mounted."""
    return [b for b, c in enumerate(layout.carrier) if c is None and all(layout.velocity[b, [0, 1, 3]] >= 0)]


def reaching(layout: Layout) -> list[int]:
    """Bodies on a carrier that commands drive along x and y."""
    return [b for b in mounted(layout) if all(layout.command[b, [0, 1]] >= 0)]


def floored(layout: Layout) -> list[int]:
    """Bodies whose height is measured."""
    return [b for b in range(len(layout.bodies)) if layout.position[b, 2] >= 0]


def usual_push(layout: Layout, scales: Scales) -> Float[Array, "b 1"]:
    """Usual size of a push on each body: its largest usual command."""
    bodies = np.array([b for b, _ in axis_indices(layout)], int)
    size = jnp.zeros(len(layout.bodies)).at[bodies].max(jnp.asarray(scales.axis_command))
    return jnp.where(size > 0, size, 1.0)[:, None]


def on_axes(
    layout: Layout, values: Iterable[Float[Array, ""]], places: Sequence[tuple[int, int]] | None = None
) -> Float[Array, "b 4"]:
    """Values per axis site as a table of bodies x axes, zero elsewhere. places: the axes, unless all of them."""
    pairs = zip(values, axis_indices(layout) if places is None else places, strict=True)
    return sum((on_body(layout, b, a, value) for value, (b, a) in pairs), jnp.zeros((len(layout.bodies), 4)))
