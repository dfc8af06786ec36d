"""Features of the motion: they bound regimes, and nonparametric laws may depend on them."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from simgap.diagnosis.likelihood.segments import Chunks
from simgap.effects.regime import Regime, values
from simgap.kinematics import motion
from simgap.layout import Layout
from simgap.rows import by_row


def of_rows(layout: Layout, chunks: Chunks) -> Float[np.ndarray, "n f"]:
    """Features of every scored row, at the beginning of the step to it."""
    counts = np.asarray(chunks.counts)
    state, command = (np.asarray(a)[:, :-1][counts] for a in (chunks.state, chunks.command))
    return by_row(values, layout, state, command)


def inside(layout: Layout, regime: Regime, chunks: Chunks) -> Bool[np.ndarray, "C T"]:
    """Which rows of the segments are in the regime."""
    feature = by_row(values, layout, np.asarray(chunks.state), np.asarray(chunks.command))[..., regime.feature]
    return regime.side * (feature - regime.edge) > 0


def seen(layout: Layout, state: Float[Array, " s"], command: Float[Array, " u"]) -> Float[Array, " n"]:
    """State in the bodies' own frames, and command; the state itself where the schema declares no bodies."""
    own = motion(layout, state)
    headings = state[jnp.array(_headings(layout), int)]
    turned = [jnp.sin(headings), jnp.cos(headings)]
    parts = [own.velocity.ravel(), own.position.ravel(), *turned] if layout.bodies else [state]
    unattached = jnp.array([i for i, f in enumerate(layout.schema.state) if layout.bodies and not f.body], int)
    return jnp.concatenate([*parts, state[unattached], command])


def _headings(layout: Layout) -> list[int]:
    """State indices of the yaws that turn the bodies' frames."""
    return list(dict.fromkeys(i for i in layout.heading if i is not None))


def seen_names(layout: Layout) -> list[str]:
    """Names of the numbers that `seen` returns."""
    names = [f"{body} {q}" for b, body in enumerate(layout.bodies) for q in _speeds(layout, b)]
    names += [f"{body} {q}" for b, body in enumerate(layout.bodies) for q in _places(layout, b)]
    if not layout.bodies:
        names = [f.name for f in layout.schema.state]
    else:
        names += [f"{q} of {layout.schema.state[i].name}" for q in ("sine", "cosine") for i in _headings(layout)]
        names += [f.name for f in layout.schema.state if not f.body]
    return names + [f.name for f in layout.schema.command]


def _speeds(layout: Layout, body: int) -> list[str]:
    """Names of a body's velocities along the four axes."""
    return _axis_names(layout, body, ["forward speed", "sideways speed", "vertical speed", "yaw rate"], "speed")


def _places(layout: Layout, body: int) -> list[str]:
    """Names of a body's positions along the first three axes."""
    return _axis_names(layout, body, ["ahead", "to the left", "height"], "position")


def _axis_names(layout: Layout, body: int, names: list[str], alone: str) -> list[str]:
    """Names of axes. If a body moves along one axis only, it is `alone`; the others, which never vary, are numbered."""
    if not layout.single(body):
        return names
    moves = (layout.velocity[body] >= 0) | (layout.position[body] >= 0)
    return [alone if moves[axis] else f"{alone} {axis + 1}" for axis in range(len(names))]
