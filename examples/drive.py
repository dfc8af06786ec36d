"""A one-axis drive: a cart on a rail, pushed by a motor. State s = [p, v], command u = [F].

    m v' = F - d v        p' = v

Over one step the force is constant and the damping acts on the mean of old and new velocity:

    v_next = ((1 - k) v + h F / m) / (1 + k),  k = h d / (2 m)
    p_next = p + h (v + v_next) / 2
"""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.types import Field, Parameter, Schema

SCHEMA = Schema(
    state=(
        Field("position", "m", "position", "world", "cart", "x"),
        Field("velocity", "m/s", "velocity", "world", "cart", "x"),
    ),
    command=(Field("cmd_force", "N", "force", "world", "cart", "x"),),
)
PARAMETERS = (
    Parameter("mass", "kg", 0.5, 8.0, nominal=2.0),
    Parameter("damping", "N s/m", 0.0, 20.0, nominal=4.0),
)


@dataclass(frozen=True)
class Drive:
    """The drive as a simulator; `time_step` h, interval between rows [s]."""

    time_step: float = 0.02
    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = PARAMETERS

    def step(
        self, params: Float[Array, " 2"], state: Float[Array, " 2"], command: Float[Array, " 1"]
    ) -> Float[Array, " 2"]:
        """The next position [m] and velocity [m/s] under a force [N]; params = [mass m [kg], damping d [N s/m]]."""
        mass, damping = params
        position, velocity = state
        k = self.time_step * damping / (2 * mass)
        velocity_next = ((1 - k) * velocity + self.time_step * command[0] / mass) / (1 + k)
        position_next = position + self.time_step * (velocity + velocity_next) / 2
        return jnp.stack([position_next, velocity_next])


DRIVE = Drive()
