"""Rigid bodies in the plane and above it: motion in a body's own frame, pushes, and vectors turned with the robot."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.layout import YAW, Layout, X, Y, Z

_Number = Float[Array, ""] | float
"""Short vectors are computed number by number and assembled last. XLA repeats the inputs of a concatenation in all that
is computed from it, so that nested concatenations take long to compile and to run."""


_Numbers = Sequence[_Number] | Float[Array, " n"]


class Motion(NamedTuple):
    """How the bodies move, each in its own frame; zero where the schema has no such field.

    velocity: relative to the carrier where there is one [m/s, m/s, m/s, rad/s]. position: from the carrier's origin,
    z above the ground [m]. heading: of the body's own frame in the world [rad].
    """

    velocity: Float[Array, "b 4"]
    position: Float[Array, "b 3"]
    heading: Float[Array, " b"]


def placed(size: int, index: int, value: Float[Array, "..."] | float) -> Float[Array, " n"]:
    """Zeros, with one or several values from an index on. XLA would compile `x.at[index].add(value)` to a loop."""
    values = jnp.atleast_1d(jnp.asarray(value))
    return jnp.pad(values, (index, size - index - len(values)))


def substituted(x: Float[Array, " n"], index: int, value: _Number) -> Float[Array, " n"]:
    """x with another value at an index. XLA would compile `x.at[index].set(value)` to a loop."""
    return jnp.where(np.arange(len(x)) == index, value, x)


def on_body(layout: Layout, b: int, axis: int, value: Float[Array, "..."]) -> Float[Array, "b 4"]:
    """A push on one body along the axes from `axis` on, one per value."""
    size = 4 * len(layout.bodies)
    return placed(size, 4 * b + axis, value).reshape(-1, 4)


def turn(x: _Number, y: _Number, angle: _Number) -> tuple[_Number, _Number]:
    """A horizontal vector turned by `angle` [rad]."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return c * x - s * y, s * x + c * y


def _rigid(velocity: _Numbers, arm: _Numbers) -> tuple[_Number, _Number]:
    return velocity[X] - velocity[YAW] * arm[Y], velocity[Y] + velocity[YAW] * arm[X]


def rigid(velocity: Float[Array, " 4"], arm: Float[Array, "..."]) -> Float[Array, " 2"]:
    """Horizontal velocity of a point at `arm` that moves rigidly with a body."""
    return jnp.stack(_rigid(velocity, arm))


def _take(values: Float[Array, " n"], indices: np.ndarray) -> list[_Number]:
    return [values[int(i)] if i >= 0 else 0.0 for i in indices]


def motion(layout: Layout, state: Float[Array, " s"]) -> Motion:
    """The bodies' motion in their own frames."""
    if not layout.bodies:
        return Motion(jnp.zeros((0, 4)), jnp.zeros((0, 3)), jnp.zeros(0))
    angles = [0.0 if heading is None else state[heading] for heading in layout.heading]
    rates = [_take(state, columns) for columns in layout.velocity]
    places = [_take(state, columns) for columns in layout.position]
    owns, worlds = [], []
    for b, ((x, y, *_), angle) in enumerate(zip(rates, angles, strict=True)):
        in_world = layout.in_world("velocity", b)
        owns.append(turn(x, y, -angle) if in_world else (x, y))
        worlds.append((x, y) if in_world else turn(x, y, angle))
    velocities, positions = [], []
    for b, carrier in enumerate(layout.carrier):
        own, at = owns[b], (0.0, 0.0)
        if carrier is not None:
            ahead, across = (places[b][axis] - places[carrier][axis] for axis in (X, Y))
            carried = _rigid([*worlds[carrier], *rates[carrier][Z:]], (ahead, across))
            x, y = (w - v for w, v in zip(worlds[b], carried, strict=True))
            own, at = turn(x, y, -angles[b]), turn(ahead, across, -angles[b])
        velocities += [*own, *rates[b][Z:]]
        positions += [*at, places[b][Z]]
    return Motion(jnp.array(velocities).reshape(-1, 4), jnp.array(positions).reshape(-1, 3), jnp.array(angles))


def carried_velocity(layout: Layout, state: Float[Array, " s"], moving: Float[Array, " s"]) -> Float[Array, " s"]:
    """What the carriers' motion contributes to the mounted bodies' velocities (world frame), zero elsewhere.

    Positions and headings are `state`'s, velocities those of `moving`.
    """
    out = jnp.zeros_like(state)
    for b, carrier in enumerate(layout.carrier):
        if carrier is None:
            continue
        p, q = _take(state, layout.position[b]), _take(state, layout.position[carrier])
        xy = _rigid(_take(moving, layout.velocity[carrier]), [p[X] - q[X], p[Y] - q[Y]])
        for axis in (X, Y):
            if layout.velocity[b, axis] >= 0:
                out = out + placed(len(state), int(layout.velocity[b, axis]), xy[axis])
    return out


def turned(layout: Layout, state: Float[Array, " s"], angle: Float[Array, " b"]) -> Float[Array, " s"]:
    """The state with each body's horizontal world-frame velocity turned by `angle` [rad]."""
    for b in range(len(layout.bodies)):
        ix, iy = (int(i) for i in layout.velocity[b, :2])
        if ix >= 0 and iy >= 0 and layout.schema.state[ix].frame == "world":
            x, y = turn(state[ix], state[iy], angle[b])
            state = substituted(substituted(state, ix, x), iy, y)
    return state


def to_own_frame(layout: Layout, vector: Float[Array, " s"], state: Float[Array, " s"]) -> Float[Array, " s"]:
    """A vector of state differences, with its world-frame pairs turned into their body's own frame."""
    return _rotated(layout, vector, state, -1.0)


def to_world(layout: Layout, vector: Float[Array, " s"], state: Float[Array, " s"]) -> Float[Array, " s"]:
    """The inverse of `to_own_frame`."""
    return _rotated(layout, vector, state, 1.0)


def _rotated(layout: Layout, vector: Float[Array, " s"], state: Float[Array, " s"], sign: float) -> Float[Array, " s"]:
    """A vector with its world-frame horizontal pairs (velocities, positions) turned by sign times their heading.

    Entries that are not turned are left in place: XLA would compile a list of all entries to three loops for each.
    """
    out = vector
    for b, heading in enumerate(layout.heading):
        if heading is None:
            continue
        for table in (layout.velocity, layout.position):
            ix, iy = (int(i) for i in table[b, [X, Y]])
            if ix >= 0 and iy >= 0 and layout.schema.state[ix].frame == "world":
                x, y = turn(vector[ix], vector[iy], sign * state[heading])
                out = substituted(substituted(out, ix, x), iy, y)
    return out


def _enter(
    layout: Layout, what: Literal["position", "velocity", "command"], b: int, heading: Array, delta: Sequence[_Number]
) -> tuple[list[_Number], list[_Number]]:
    """The part of a body's own-frame push that enters along the axes of a table, and the rest, in the own frame.

    The rest is the part along world axes that the table lacks.
    """
    has = getattr(layout, what)[b] >= 0
    in_world = has[[X, Y]].any() and layout.in_world(what, b)
    along = [*turn(delta[X], delta[Y], heading), *delta[Z:]] if in_world else delta
    entered = [d if h else 0.0 for d, h in zip(along, has, strict=True)]
    left = [0.0 if h else d for d, h in zip(along, has, strict=True)]
    return entered, [*turn(left[X], left[Y], -heading), *left[Z:]] if in_world else left


def _filled(size: int, table: np.ndarray, entered: Sequence[Sequence[_Number]]) -> Float[Array, " n"]:
    """Values along each body's axes, placed in the columns of a table."""
    values: list[_Number] = [0.0] * size
    for columns, delta in zip(table, entered, strict=True):
        for column, d in zip(columns, delta, strict=True):
            if column >= 0:
                values[column] += d
    return jnp.array(values)


def push(
    layout: Layout, heading: Float[Array, " b"], delta: Float[Array, "b 4"]
) -> tuple[Float[Array, " u"], Float[Array, " s"], Float[Array, " s"]]:
    """A push on each body, in its own frame, as additions to the command, to the velocities and to position rates.

    Where a command drives the axis, the push enters there, in the command's unit, so that the simulator's own dynamics
    act on it. Otherwise it adds to the velocity, half before and half after every step, or to the rate of a position
    without velocity. For example, a sideways push on a car whose state has only its forward speed moves both x and y.
    """
    tables: list[list[list[_Number]]] = [[], [], []]
    for b in range(len(layout.bodies)):
        rest = list(delta[b])
        for table, what in zip(tables, ("command", "velocity", "position"), strict=True):
            entered, rest = _enter(layout, what, b, heading[b], rest)
            table.append(entered)
    n_state = len(layout.schema.state)
    u, v, p = tables
    return (
        _filled(len(layout.schema.command), layout.command, u),
        _filled(n_state, layout.velocity, v),
        _filled(n_state, layout.position, p),
    )


def commanded(layout: Layout, b: int, heading: Float[Array, ""], command: Float[Array, " u"]) -> Float[Array, " 4"]:
    """The commands that drive body `b`, in its own frame; zero along axes without one."""
    x, y, *rest = _take(command, layout.command[b])
    return jnp.array([*(turn(x, y, -heading) if layout.in_world("command", b) else (x, y)), *rest])


def wrapped(layout: Layout, difference: Float[Array, "... s"]) -> Float[Array, "... s"]:
    """Differences of states, with angles wrapped to -pi .. pi."""
    turns = jnp.where(layout.angles, jnp.round(difference / (2 * jnp.pi)), 0.0)
    return difference - 2 * jnp.pi * turns
