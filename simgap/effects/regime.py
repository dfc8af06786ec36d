"""Regimes in which an effect acts: a feature of the robot's motion or command lies above or below an edge."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from simgap.kinematics import Motion, motion
from simgap.layout import YAW, Layout, Z


class Regime(NamedTuple):
    """Rows whose feature with this index lies above an edge (side 1) or below it (side -1)."""

    feature: int
    side: float
    edge: float


EVERYWHERE = Regime(0, 1.0, -np.inf)


class Acting(NamedTuple):
    """Internal constants of all effects at all sites, and how much they change in each of S regimes."""

    theta: Float[np.ndarray, " P"]
    delta: Float[np.ndarray, "S P"]
    regimes: tuple[Regime, ...]


def everywhere(theta: Float[np.ndarray, " P"]) -> Acting:
    """The same constants in every regime."""
    return Acting(theta, np.zeros((0, len(theta)), theta.dtype), ())


class Feature(NamedTuple):
    """A quantity that defines regimes: name, unit, and value in a row, from the own motion, state and command."""

    name: str
    unit: str
    of: Callable[[Motion, Float[Array, " s"], Float[Array, " u"]], Float[Array, ""]]


def features(layout: Layout) -> list[Feature]:
    """Speed, yaw rate, reach and height of every body that has them, and every command and its absolute value.

    A body that only turns about one axis, such as a joint, has a speed and no yaw rate. The own speed of a mounted
    body is relative to its carrier.
    """
    return [*(f for b in range(len(layout.bodies)) for f in _of_body(layout, b)), *_of_commands(layout)]


def _of_body(layout: Layout, b: int) -> Iterator[Feature]:
    body, mounted = layout.bodies[b], layout.carrier[b] is not None
    moves = [int(i) for i in layout.velocity[b, :YAW] if i >= 0]
    if moves:
        yield Feature(f"{body} speed", "m/s", lambda own, state, command: jnp.linalg.norm(state[np.array(moves)]))
        if mounted:
            yield Feature(f"{body} own speed", "m/s", lambda own, *_: jnp.linalg.norm(own.velocity[b, :YAW]))
    if layout.velocity[b, YAW] >= 0:
        turn = f"{body} speed" if layout.single(b) else f"{body} |yaw rate|"
        yield Feature(turn, "rad/s", lambda own, *_: jnp.abs(own.velocity[b, YAW]))
    if mounted:
        only = sum(c is not None for c in layout.carrier) == 1
        yield Feature("reach" if only else f"{body} reach", "m", lambda own, *_: jnp.linalg.norm(own.position[b, :Z]))
    if layout.position[b, Z] >= 0:
        yield Feature(f"{body} height", "m", lambda own, *_: own.position[b, Z])


def _of_commands(layout: Layout) -> Iterator[Feature]:
    for i, f in enumerate(layout.schema.command):
        yield Feature(f.name, f.unit, lambda own, state, command, i=i: command[i])
        yield Feature(f"|{f.name}|", f.unit, lambda own, state, command, i=i: jnp.abs(command[i]))


def values(layout: Layout, state: Float[Array, " s"], command: Float[Array, " u"]) -> Float[Array, " f"]:
    """The features of one row."""
    own = motion(layout, state)
    return jnp.stack([f.of(own, state, command) for f in features(layout)])


def holds(layout: Layout, regime: Regime, state: Float[Array, " s"], command: Float[Array, " u"]) -> Bool[Array, ""]:
    """Whether a row is in the regime."""
    return regime.side * (values(layout, state, command)[regime.feature] - regime.edge) > 0


def words(layout: Layout, regime: Regime) -> str:
    """The regime as a rule, such as `reach > 0.93 m`."""
    feature = features(layout)[regime.feature]
    return f"{feature.name} {'>' if regime.side > 0 else '<'} {regime.edge:.3g} {feature.unit}"
