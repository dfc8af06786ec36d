"""The residual's coordinates: the robot's own frame, so that what is learnt in one place holds in every place."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.layout import Layout, X, Y
from simgap.recordings import decode_state, encode_state
from simgap.types import Schema, Simulator


def features(simulator: Simulator, x: Float[Array, " x"]) -> Float[Array, " f"]:
    """What a residual depends on: the state in body coordinates without the place of what stands on the ground, and
    the commands."""
    schema = simulator.schema
    encoded = len(schema.encoded)
    body = simulator.to_body(decode_state(schema, x[:encoded]))
    return jnp.concatenate([body[np.flatnonzero(~_places(schema))], x[encoded:]])


def lift(schema: Schema, x: Float[Array, " x"]) -> Float[Array, "y s"]:
    """J: a small change of the state along the axes of each body's own frame as a change of the encoded state.

    Its columns are orthonormal, so its transpose takes an encoded change back.
    """
    encoded = x[: len(schema.encoded)]
    state = decode_state(schema, encoded)
    layout = Layout(schema)
    R = jnp.eye(len(schema.state))
    for body, heading in enumerate(layout.heading):
        for kind in ("position", "velocity"):
            i, j = getattr(layout, kind)[body, [X, Y]]
            if heading is not None and min(i, j) >= 0 and layout.in_world(kind, body):
                cos, sin = jnp.cos(state[heading]), jnp.sin(state[heading])
                R = R.at[i, i].set(cos).at[i, j].set(-sin).at[j, i].set(sin).at[j, j].set(cos)
    return jax.jacfwd(lambda s: encode_state(schema, s))(state) @ R


def _places(schema: Schema) -> np.ndarray:
    """Which states say where a body stands that is mounted on none."""
    mounted = {body for body, _ in schema.mounts}
    return np.array([f.kind in ("position", "angle") and f.body not in mounted for f in schema.state])
