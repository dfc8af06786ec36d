"""All that a fit can change, and the constants that act in a row."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from simgap.effects.augmented import Theta


class Variables(NamedTuple):
    """All that can be fitted.

    phi: simulator parameters. gain: diagonal of K. cross: its off-diagonal entries (`Layout.akin`). theta: effects'
    constants. delta: how much these differ where each of S supports is open.
    """

    phi: Float[np.ndarray, " p"]
    gain: Float[np.ndarray, " s"]
    cross: Float[np.ndarray, " c"]
    theta: Float[np.ndarray, " P"]
    delta: Float[np.ndarray, "S P"]


def acting(v: Variables, theta: Theta, gate: Sequence[Float[Array, ""]] | Float[Array, " S"]) -> Theta:
    """Constants in one row: theta + sum_s gate_s delta_s."""
    for s in range(len(v.delta)):
        theta = theta + gate[s] * v.delta[s]
    return theta
