"""A car with front steering (bicycle model). State s = [x, y, yaw, v], command u = [speed, steering angle].

(x, y) is the middle of the rear axle, which moves along the yaw without sliding:

    x' = v cos(yaw)     y' = v sin(yaw)     yaw' = v tan(steering + trim) / wheelbase     v' = (gain speed - v) / tau

Over one step h the commands are constant. Speed and distance are exact, the car moves along the chord of its arc:

    v_next = u + (v - u) exp(-h / tau),  u = gain speed
    distance = h u + (v - v_next) tau
    yaw_next = yaw + distance tan(steering + trim) / wheelbase
    (x, y)_next = (x, y) + distance (cos, sin)((yaw + yaw_next) / 2)
"""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.types import Field, Parameter, Schema

SCHEMA = Schema(
    state=(
        Field("x", "m", "position", "world", "car", "x"),
        Field("y", "m", "position", "world", "car", "y"),
        Field("yaw", "rad", "angle", "world", "car", "yaw"),
        Field("speed", "m/s", "velocity", "body", "car", "x"),
    ),
    command=(
        Field("cmd_speed", "m/s", "velocity", "body", "car", "x"),
        # A steering angle drives no velocity along an axis: it has neither body nor axis.
        Field("cmd_steering", "rad", "angle", "body"),
    ),
)
PARAMETERS = (
    Parameter("wheelbase", "m", 0.2, 0.5, nominal=0.32),
    Parameter("speed_time_constant", "s", 0.05, 1.0, nominal=0.3),
    Parameter("speed_gain", "-", 0.7, 1.3, nominal=1.0),
    Parameter("steering_trim", "rad", -0.1, 0.1, nominal=0.0),
)


@dataclass(frozen=True)
class Car:
    """The car as a simulator; `time_step` h, interval between rows [s]."""

    time_step: float = 0.05
    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = PARAMETERS

    def step(
        self, params: Float[Array, " 4"], state: Float[Array, " 4"], command: Float[Array, " 2"]
    ) -> Float[Array, " 4"]:
        """The next pose [m, m, rad] and speed [m/s] under a desired speed [m/s] and a steering angle [rad].

        params = [wheelbase [m], time constant tau of the speed [s], gain of the speed [-], trim of the steering [rad]].
        """
        wheelbase, tau, gain, trim = params
        x, y, yaw, speed = state
        desired = gain * command[0]
        speed_next = desired + (speed - desired) * jnp.exp(-self.time_step / tau)
        distance = self.time_step * desired + (speed - speed_next) * tau
        yaw_next = yaw + distance * jnp.tan(command[1] + trim) / wheelbase
        heading = (yaw + yaw_next) / 2
        return jnp.stack([x + distance * jnp.cos(heading), y + distance * jnp.sin(heading), yaw_next, speed_next])


CAR = Car()
