"""Simulators of five kinds of machines, as a user might have written them.

    simgap diagnose LOGS --simulator examples.kinds:BOAT

Each integrates its equations of motion over a row by the classical Runge-Kutta rule. Masses and coefficients are
parameters; lengths and what is the same everywhere are not.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.types import Axis, Field, Parameter, Schema

GRAVITY = 9.81
POLE = 0.5
"""Length of the pole that hangs from the cart [m]."""
LINKS = (0.4, 0.35)
"""Lengths of the arm's links [m]."""


def _integrated(rates: Callable[[Array], Array], state: Array, h: float) -> Array:
    """The state after h seconds."""
    first = rates(state)
    second = rates(state + h / 2 * first)
    third = rates(state + h / 2 * second)
    fourth = rates(state + h * third)
    return state + h / 6 * (first + 2 * second + 2 * third + fourth)


def _pose(body: str) -> tuple[Field, Field, Field]:
    """Position and heading of a body that moves over the ground or the water."""
    return (
        Field("x", "m", "position", "world", body, "x"),
        Field("y", "m", "position", "world", body, "y"),
        Field("yaw", "rad", "angle", "world", body, "yaw"),
    )


def _force(name: str, body: str, axis: Axis, unit: str = "N") -> Field:
    return Field(name, unit, "force", "body", body, axis)


class Crane:
    """A cart on a track, driven by a force, from which a pole hangs on a free joint."""

    time_step = 0.02
    schema = Schema(
        (
            Field("cart_x", "m", "position", "world", "cart", "x"),
            Field("pole_angle", "rad", "angle", "world", "pole", "yaw"),
            Field("cart_v", "m/s", "velocity", "world", "cart", "x"),
            Field("pole_rate", "rad/s", "velocity", "world", "pole", "yaw"),
        ),
        (_force("force", "cart", "x"),),
    )
    parameters = (
        Parameter("cart_mass", "kg", 0.5, 2.0, nominal=1.0),
        Parameter("pole_mass", "kg", 0.05, 0.5, nominal=0.2),
    )

    def step(
        self, params: Float[Array, " 2"], state: Float[Array, " 4"], command: Float[Array, " 1"]
    ) -> Float[Array, " 4"]:
        """The next position [m], angle [rad] from hanging down, and their rates."""
        cart, pole = params

        def rates(state: Array) -> Array:
            _, angle, v, rate = state
            sine, cosine = jnp.sin(angle), jnp.cos(angle)
            pull = command[0] + pole * sine * (POLE * rate**2 + GRAVITY * cosine)
            cart_rate = pull / (cart + pole * sine**2)
            return jnp.stack([v, rate, cart_rate, -(cart_rate * cosine + GRAVITY * sine) / POLE])

        return _integrated(rates, state, self.time_step)


class Drone:
    """A drone in a vertical plane: thrust along its own upward axis, and a torque that pitches it."""

    time_step = 0.02
    schema = Schema(
        (
            Field("x", "m", "position", "world", "drone", "x"),
            Field("z", "m", "position", "world", "drone", "z"),
            # Its pitch turns in the plane of x and z, not about the vertical: another body.
            Field("pitch", "rad", "angle", "world", "tilt", "yaw"),
            Field("vx", "m/s", "velocity", "world", "drone", "x"),
            Field("vz", "m/s", "velocity", "world", "drone", "z"),
            Field("pitch_rate", "rad/s", "velocity", "world", "tilt", "yaw"),
        ),
        (Field("thrust", "N", "force", "body"), _force("torque", "tilt", "yaw", "N m")),
    )
    parameters = (
        Parameter("mass", "kg", 0.6, 1.6, nominal=1.0),
        Parameter("inertia", "kg m^2", 0.005, 0.02, nominal=0.01),
    )

    def step(
        self, params: Float[Array, " 2"], state: Float[Array, " 6"], command: Float[Array, " 2"]
    ) -> Float[Array, " 6"]:
        """The next position [m], pitch [rad], and their rates."""
        mass, inertia = params
        thrust, torque = command

        def rates(state: Array) -> Array:
            _, _, pitch, vx, vz, rate = state
            across, up = -thrust * jnp.sin(pitch) / mass, thrust * jnp.cos(pitch) / mass - GRAVITY
            return jnp.stack([vx, vz, rate, across, up, torque / inertia])

        return _integrated(rates, state, self.time_step)


class Boat:
    """A boat with a thruster and a rudder that turns it; the water brakes it in proportion to its speed."""

    time_step = 0.1
    schema = Schema(
        (
            *_pose("boat"),
            Field("surge", "m/s", "velocity", "body", "boat", "x"),
            Field("sway", "m/s", "velocity", "body", "boat", "y"),
            Field("turn", "rad/s", "velocity", "world", "boat", "yaw"),
        ),
        (_force("thrust", "boat", "x"), _force("moment", "boat", "yaw", "N m")),
    )
    parameters = (
        Parameter("mass", "kg", 15.0, 50.0, nominal=30.0),
        Parameter("inertia", "kg m^2", 2.0, 10.0, nominal=5.0),
        Parameter("surge_drag", "N s/m", 5.0, 40.0, nominal=15.0),
        Parameter("sway_drag", "N s/m", 20.0, 150.0, nominal=60.0),
        Parameter("turn_drag", "N m s", 2.0, 20.0, nominal=8.0),
    )

    def step(
        self, params: Float[Array, " 5"], state: Float[Array, " 6"], command: Float[Array, " 2"]
    ) -> Float[Array, " 6"]:
        """The next pose [m, m, rad] and velocities along and about the boat's own axes."""
        mass, inertia, along, across, about = params

        def rates(state: Array) -> Array:
            _, _, yaw, surge, sway, turn = state
            sine, cosine = jnp.sin(yaw), jnp.cos(yaw)
            moved = [cosine * surge - sine * sway, sine * surge + cosine * sway, turn]
            surge_rate = (command[0] - along * surge) / mass + sway * turn
            sway_rate = -across * sway / mass - surge * turn
            return jnp.stack([*moved, surge_rate, sway_rate, (command[1] - about * turn) / inertia])

        return _integrated(rates, state, self.time_step)


class TwoLinks:
    """An arm of two links in a vertical plane, with a motor's torque at both joints. Angles are from hanging down."""

    time_step = 0.01
    schema = Schema(
        (
            Field("shoulder", "rad", "angle", "world", "upper", "yaw"),
            Field("elbow", "rad", "angle", "world", "lower", "yaw"),
            Field("shoulder_rate", "rad/s", "velocity", "world", "upper", "yaw"),
            Field("elbow_rate", "rad/s", "velocity", "world", "lower", "yaw"),
        ),
        (_force("shoulder_torque", "upper", "yaw", "N m"), _force("elbow_torque", "lower", "yaw", "N m")),
    )
    parameters = (
        Parameter("upper_mass", "kg", 0.5, 3.0, nominal=1.5),
        Parameter("lower_mass", "kg", 0.3, 2.0, nominal=1.0),
        Parameter("shoulder_damping", "N m s", 0.0, 0.5, nominal=0.1),
        Parameter("elbow_damping", "N m s", 0.0, 0.5, nominal=0.1),
    )

    def step(
        self, params: Float[Array, " 4"], state: Float[Array, " 4"], command: Float[Array, " 2"]
    ) -> Float[Array, " 4"]:
        """The next angles [rad] and their rates."""
        upper, lower, *damping = params
        a, b = LINKS

        def rates(state: Array) -> Array:
            shoulder, elbow, first, second = state
            cross = lower * a * b / 2
            own, both = lower * b**2 / 3, lower * b**2 / 3 + cross * jnp.cos(elbow)
            whole = upper * a**2 / 3 + lower * a**2 + own + 2 * cross * jnp.cos(elbow)
            hangs = lower * GRAVITY * b / 2 * jnp.sin(shoulder + elbow)
            heavy = (upper / 2 + lower) * GRAVITY * a * jnp.sin(shoulder) + hangs
            turning = cross * jnp.sin(elbow)
            p = command[0] - damping[0] * first - heavy + turning * second * (2 * first + second)
            q = command[1] - damping[1] * second - hangs - turning * first**2
            free = whole * own - both**2
            return jnp.stack([first, second, (own * p - both * q) / free, (whole * q - both * p) / free])

        return _integrated(rates, state, self.time_step)


class TwoWheels:
    """A base on two wheels that follows a commanded speed and turning rate, each with a time constant."""

    time_step = 0.05
    schema = Schema(
        (
            *_pose("base"),
            Field("speed", "m/s", "velocity", "body", "base", "x"),
            Field("turn", "rad/s", "velocity", "world", "base", "yaw"),
        ),
        (
            Field("cmd_speed", "m/s", "velocity", "body", "base", "x"),
            Field("cmd_turn", "rad/s", "velocity", "body", "base", "yaw"),
        ),
    )
    parameters = (
        Parameter("speed_time", "s", 0.05, 0.6, nominal=0.2),
        Parameter("turn_time", "s", 0.05, 0.6, nominal=0.15),
    )

    def step(
        self, params: Float[Array, " 2"], state: Float[Array, " 5"], command: Float[Array, " 2"]
    ) -> Float[Array, " 5"]:
        """The next pose [m, m, rad], speed and turning rate."""

        def rates(state: Array) -> Array:
            _, _, yaw, speed, turn = state
            slower = [(command[0] - speed) / params[0], (command[1] - turn) / params[1]]
            return jnp.stack([speed * jnp.cos(yaw), speed * jnp.sin(yaw), turn, *slower])

        return _integrated(rates, state, self.time_step)


CRANE, DRONE, BOAT, TWO_LINKS, TWO_WHEELS = Crane(), Drone(), Boat(), TwoLinks(), TwoWheels()
