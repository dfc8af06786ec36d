"""In which regime an effect acts: where what the robot does, or is told to do, lies above or below an edge."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from simgap.layout import YAW, Layout, motion


class Regime(NamedTuple):
    """Where the feature of this number lies above an edge (side 1) or below it (side -1)."""

    feature: int
    side: float
    edge: float


EVERYWHERE = Regime(0, 1.0, -np.inf)


class Acting(NamedTuple):
    """Internal constants of all effects at all sites: those in a regime, and those elsewhere."""

    theta: Float[np.ndarray, " P"]
    within: Float[np.ndarray, " P"]
    regime: Regime


def everywhere(theta: Float[np.ndarray, " P"]) -> Acting:
    """The same constants in every regime."""
    return Acting(theta, theta, EVERYWHERE)


class Feature(NamedTuple):
    """What regimes are told by, and its unit."""

    name: str
    unit: str


def features(layout: Layout) -> list[Feature]:
    """Speed, yaw rate, reach and height of every body that has them, and every command and its size.

    The own speed of a body that another carries is that beside the other's.
    """
    found = []
    for b, body in enumerate(layout.bodies):
        if (layout.velocity[b, :3] >= 0).any():
            found.append(Feature(f"{body} speed", "m/s"))
            if layout.carrier[b] is not None:
                found.append(Feature(f"{body} own speed", "m/s"))
        if layout.velocity[b, YAW] >= 0:
            found.append(Feature(f"{body} |yaw rate|", "rad/s"))
        if layout.carrier[b] is not None:
            found.append(Feature("reach" if sum(c is not None for c in layout.carrier) == 1 else f"{body} reach", "m"))
        if layout.position[b, 2] >= 0:
            found.append(Feature(f"{body} height", "m"))
    for f in layout.schema.command:
        found += [Feature(f.name, f.unit), Feature(f"|{f.name}|", f.unit)]
    return found


def values(layout: Layout, state: Float[Array, " s"], command: Float[Array, " u"]) -> Float[Array, " f"]:
    """The features of one row, in their order."""
    own, found = motion(layout, state), []
    for b in range(len(layout.bodies)):
        if (layout.velocity[b, :3] >= 0).any():
            found.append(jnp.linalg.norm(state[layout.velocity[b, :3][layout.velocity[b, :3] >= 0]]))
            if layout.carrier[b] is not None:
                found.append(jnp.linalg.norm(own.velocity[b, :3]))
        if layout.velocity[b, YAW] >= 0:
            found.append(jnp.abs(own.velocity[b, YAW]))
        if layout.carrier[b] is not None:
            found.append(jnp.linalg.norm(own.position[b, :2]))
        if layout.position[b, 2] >= 0:
            found.append(own.position[b, 2])
    commands = jnp.stack([command, jnp.abs(command)], axis=1).ravel()
    return jnp.concatenate([jnp.stack(found), commands])


def holds(layout: Layout, regime: Regime, state: Float[Array, " s"], command: Float[Array, " u"]) -> Bool[Array, ""]:
    """Whether a row is in the regime."""
    return regime.side * (values(layout, state, command)[regime.feature] - regime.edge) > 0


def words(layout: Layout, regime: Regime) -> str:
    """As a rule: `reach > 0.93 m`."""
    name, unit = features(layout)[regime.feature]
    return f"{name} {'>' if regime.side > 0 else '<'} {regime.edge:.3g} {unit}"
