"""Simple simulators of machines whose public recordings show physics that these leave out.

    simgap diagnose LOGS --simulator examples.machines:BALL

Where recordings have no velocity, or a late one, the velocity is a state that is estimated (`observed=False`).
"""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.types import Field, Parameter, Schema

GRAVITY = 9.81


_BALL = Schema(
    (
        Field("height", "m", "position", "world", "ball", "z"),
        Field("speed", "m/s", "velocity", "world", "ball", "z", observed=False),
    ),
    (),
)


@dataclass(frozen=True)
class Ball:
    """A ball that falls freely: h'' = -g."""

    time_step: float = 1 / 15
    schema: Schema = _BALL
    parameters: tuple[Parameter, ...] = ()

    def step(  # it has neither parameters nor commands
        self,
        params: Float[Array, " 0"],  # noqa: ARG002
        state: Float[Array, " 2"],
        command: Float[Array, " 0"],  # noqa: ARG002
    ) -> Float[Array, " 2"]:
        """The next height [m] and speed [m/s]."""
        height, speed = state
        h = self.time_step
        return jnp.stack([height + h * speed - GRAVITY * h**2 / 2, speed - GRAVITY * h])


_CAR = Schema(
    (
        Field("x", "m", "position", "world", "car", "x"),
        Field("y", "m", "position", "world", "car", "y"),
        Field("yaw", "rad", "angle", "world", "car", "yaw"),
        Field("speed", "m/s", "velocity", "body", "car", "x"),
    ),
    (Field("steer", "-", "force", "body"), Field("throttle", "-", "force", "body", "car", "x")),
)


@dataclass(frozen=True)
class RaceCar:
    """A small race car: v' = a throttle - b v - c sign(v), yaw' = k v steer; it moves along its heading."""

    time_step: float = 1 / 30
    schema: Schema = _CAR
    parameters: tuple[Parameter, ...] = (
        Parameter("drive", "m/s^2", 1.0, 30.0, nominal=8.0),
        Parameter("drag", "1/s", 0.0, 5.0, nominal=1.0),
        Parameter("friction", "m/s^2", 0.0, 5.0, nominal=0.5),
        Parameter("steering", "rad/m", -5.0, 5.0, nominal=1.0),
    )

    def step(
        self, params: Float[Array, " 4"], state: Float[Array, " 4"], command: Float[Array, " 2"]
    ) -> Float[Array, " 4"]:
        """The next pose [m, m, rad] and speed [m/s] under shares of full steering and full throttle."""
        drive, drag, friction, steering = params
        x, y, yaw, speed = state
        steer, throttle = command
        h = self.time_step
        # The friction turns with the speed within 0.1 m/s: a jump would have no derivative.
        pull = drive * throttle - drag * speed - friction * jnp.tanh(speed / 0.1)
        then = speed + h * pull
        mean = (speed + then) / 2
        turn = h * steering * mean * steer
        heading = yaw + turn / 2
        return jnp.stack([x + h * mean * jnp.cos(heading), y + h * mean * jnp.sin(heading), yaw + turn, then])


@dataclass(frozen=True)
class Servo:
    """One joint with a position servo: q'' = w^2 (u - q) - 2 z w q'.

    In steps of an eighth of a row, by the implicit midpoint rule.
    """

    joint: str
    time_step: float = 0.02006
    parameters: tuple[Parameter, ...] = (
        Parameter("frequency", "rad/s", 5.0, 120.0, nominal=60.0),
        Parameter("damping", "-", 0.1, 3.0, nominal=0.7),
    )

    SUBSTEPS = 8

    @property
    def schema(self) -> Schema:
        """The joint's own columns."""
        joint = self.joint
        return Schema(
            (
                Field(f"{joint}_pos", "rad", "position", "body", joint, "yaw"),
                Field(f"{joint}_vel", "rad/s", "velocity", "body", joint, "yaw", observed=False),
            ),
            (Field(f"cmd_{joint}", "rad", "position", "body", joint, "yaw"),),
        )

    def step(
        self, params: Float[Array, " 2"], state: Float[Array, " 2"], command: Float[Array, " 1"]
    ) -> Float[Array, " 2"]:
        """The next position [rad] and velocity [rad/s] under a desired position [rad]."""
        frequency, damping = params
        position, velocity = state
        h = self.time_step / self.SUBSTEPS
        for _ in range(self.SUBSTEPS):
            middle = (velocity + h / 2 * frequency**2 * (command[0] - position)) / (
                1 + h * damping * frequency + (h * frequency) ** 2 / 4
            )
            position, velocity = position + h * middle, 2 * middle - velocity
        return jnp.stack([position, velocity])


_PENDULUM = Schema(
    (
        Field("pos", "rad", "position", "body", "pendulum", "yaw"),
        Field("vel", "rad/s", "velocity", "body", "pendulum", "yaw", observed=False),
    ),
    (
        Field("goal", "rad", "position", "body", "pendulum", "yaw"),
        Field("enable", "-", "force", "body"),
        Field("volts", "V", "force", "body"),
        Field("kp", "-", "force", "body"),
    ),
)


@dataclass(frozen=True)
class ServoPendulum:
    """A hobby servo that swings a mass m at a distance l, with its own controller and supply.

    duty = 0.002877 kp (goal - q) where it is enabled
    (m l^2 + armature) q'' = k volts duty - damping q' - m g l sin(q + q0)

    In steps of a quarter of a row, by the semi-implicit Euler rule. Of the duty's limits it knows nothing.
    """

    time_step: float = 0.005
    schema: Schema = _PENDULUM
    parameters: tuple[Parameter, ...] = (
        Parameter("torque_per_volt", "N m/V", 0.01, 0.5, nominal=0.1),
        Parameter("armature", "kg m^2", 1e-4, 0.01, nominal=0.002),
        Parameter("damping", "N m s/rad", 0.0, 1.0, nominal=0.1),
        Parameter("offset", "rad", -0.2, 0.2, nominal=0.0),
    )

    MASS = 0.49
    LENGTH = 0.1
    GAIN = 0.002877
    """Duty per unit of kp and radian, by the maker's data sheet."""
    SUBSTEPS = 4

    def step(
        self, params: Float[Array, " 4"], state: Float[Array, " 2"], command: Float[Array, " 4"]
    ) -> Float[Array, " 2"]:
        """The next angle [rad] and velocity [rad/s]; command = [goal [rad], enabled [0 or 1], supply [V], kp]."""
        per_volt, armature, damping, offset = params
        angle, velocity = state
        goal, enable, volts, kp = command
        h = self.time_step / self.SUBSTEPS
        for _ in range(self.SUBSTEPS):
            duty = enable * self.GAIN * kp * (goal - angle)
            torque = per_volt * volts * duty - damping * velocity
            torque = torque - self.MASS * GRAVITY * self.LENGTH * jnp.sin(angle + offset)
            velocity = velocity + h * torque / (self.MASS * self.LENGTH**2 + armature)
            angle = angle + h * velocity
        return jnp.stack([angle, velocity])


BALL, RACE_CAR, SERVO_PENDULUM = Ball(), RaceCar(), ServoPendulum()
SHOULDER_PAN, SHOULDER_LIFT, ELBOW_FLEX, WRIST_FLEX, WRIST_ROLL = (
    Servo(joint) for joint in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
)
