"""Machines of the training ground whose axes move each other, and of which some are not driven.

Units are such that usual speeds and commands are near one: gravity pulls with 2.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from simgap.ground.machine import Integrated
from simgap.types import Axis, Field, Kind, Parameter, Schema

GRAVITY = 2.0
POLE = 0.5
"""From the trolley to the weight below it [m]."""
LINKS = 0.3, 0.5
"""Lengths of the upper and the lower link [m]."""
TILT = 0.8
"""Of a flyer, at most [rad]."""
OFTEN_LONG = 0.2
"""Share of the cases with long recordings: a diagnosis of several axes takes long."""


@dataclass(frozen=True)
class Coupled(Integrated):
    """A machine whose accelerations follow from forces and a mass matrix, which its `acceleration` solves."""

    mass: Callable[[Any, Any, Any], Any] = field(kw_only=True)
    """(numpy or jax.numpy, parameters, positions) -> mass matrix."""

    def pushed(self, params: Any, q: Any, push: Any) -> Any:
        """Accelerations by a push that would give each axis `push` if the others were held."""
        mass = self.mass(np, params, q)
        return np.linalg.solve(mass, np.diag(mass) * push)

    def rate(self, params: Float[np.ndarray, " p"]) -> float:
        """See `Machine`: with the other axes held."""
        return float(1 / np.array(self.mass(np, params, self.start))[0, 0])


@dataclass(frozen=True)
class Flyer(Integrated):
    """A flyer in a vertical plane: thrust along its own upward axis, and a torque that pitches it."""

    def sent(self, drawn: Float[np.ndarray, " 2"], state: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 2"]:
        """See `Machine`: thrust and torque of a pilot who flies to a drawn height and place."""
        x, z, pitch, vx, vz, rate = state
        lean = np.clip(0.5 * (x - drawn[1]) + 0.7 * vx, -TILT, TILT)
        return np.array([1 + np.clip(drawn[0] - z - vz, -0.9, 1.5), np.clip(4 * (lean - pitch) - 1.5 * rate, -2, 2)])


def _trolley_mass(xp: Any, p: Any, q: Any) -> Any:
    cart, weight, _ = p
    both = weight * POLE * xp.cos(q[1])
    return xp.array([[cart + weight, both], [both, weight * POLE**2]])


def _trolley(xp: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:
    _, weight, damping = p
    sine = xp.sin(q[1])
    forces = [u[0] - damping * v[0] + weight * POLE * v[1] ** 2 * sine, -weight * GRAVITY * POLE * sine]
    return list(xp.linalg.solve(_trolley_mass(xp, p, q), xp.array(forces)))


def _links_mass(xp: Any, p: Any, q: Any) -> Any:
    upper, lower, _ = p
    a, b = LINKS
    turned, own = lower * a * b / 2 * xp.cos(q[1]), lower * b**2 / 3
    return xp.array([[upper * a**2 / 3 + lower * a**2 + own + 2 * turned, own + turned], [own + turned, own]])


def _links(xp: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:
    """Two links that hang from a wall, with a motor at both joints."""
    upper, lower, damping = p
    a, b = LINKS
    hangs = lower * GRAVITY * b / 2 * xp.sin(q[0] + q[1])
    heavy = (upper / 2 + lower) * GRAVITY * a * xp.sin(q[0]) + hangs
    turning = lower * a * b / 2 * xp.sin(q[1])
    forces = [
        u[0] - damping * v[0] - heavy + turning * v[1] * (2 * v[0] + v[1]),
        u[1] - damping * v[1] - hangs - turning * v[0] ** 2,
    ]
    return list(xp.linalg.solve(_links_mass(xp, p, q), xp.array(forces)))


def _flyer(xp: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:  # noqa: ARG001
    mass, inertia = p
    return [-u[0] * xp.sin(q[2]) / mass, u[0] * xp.cos(q[2]) / mass - GRAVITY, u[1] / inertia]


def _hull(_: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:  # noqa: ARG001
    """A ship with a thruster and a rudder: nothing drives it sideways but its turning."""
    mass, inertia, along, across, about = p
    return [
        (u[0] - along * v[0]) / mass + v[1] * v[2],
        -across * v[1] / mass - v[0] * v[2],
        (u[1] - about * v[2]) / inertia,
    ]


def _afloat(xp: Any, q: Any, v: Any) -> list[Any]:
    sine, cosine = xp.sin(q[2]), xp.cos(q[2])
    return [cosine * v[0] - sine * v[1], sine * v[0] + cosine * v[1], v[2]]


def _wheels(_: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:  # noqa: ARG001
    """A base on two wheels, which follow speeds."""
    return [(u[i] - v[i]) / p[i] for i in range(2)]


def _rolling(xp: Any, q: Any, v: Any) -> list[Any]:
    return [xp.cos(q[2]) * v[0], xp.sin(q[2]) * v[0], v[1]]


def _state(name: str, body: str, kind: Kind, axis: Axis) -> Field:
    """Of a position, an angle or a velocity in the world."""
    unit = ("rad" if axis == "yaw" else "m") + ("/s" if kind == "velocity" else "")
    return Field(name, unit, kind, "world", body, axis)


def _own(name: str, body: str, axis: Axis) -> Field:
    """Of a velocity along a body's own axis."""
    return Field(name, "m/s", "velocity", "body", body, axis)


def _force(name: str, body: str, axis: Axis) -> Field:
    return Field(name, "N m" if axis == "yaw" else "N", "force", "body", body, axis)


def _joints(first: tuple[str, str, Axis], second: tuple[str, str, Axis]) -> tuple[Field, ...]:
    """Positions and velocities of two axes, each given by name, body and direction."""
    axes = first, second
    positions = (_state(name, body, "angle" if axis == "yaw" else "position", axis) for name, body, axis in axes)
    return *positions, *(_state(f"{name}_vel", body, "velocity", axis) for name, body, axis in axes)


def _pose(body: str) -> tuple[Field, Field, Field]:
    x, y = (_state(axis, body, "position", axis) for axis in ("x", "y"))
    return x, y, _state("yaw", body, "angle", "yaw")


TROLLEY = Coupled(
    "trolley",
    Schema(
        _joints(("trolley", "trolley", "x"), ("pole", "pole", "yaw")),
        (_force("force", "trolley", "x"),),
    ),
    (
        Parameter("cart_mass", "kg", 0.2, 1.0),
        Parameter("weight_mass", "kg", 0.05, 0.4),
        Parameter("damping", "N s/m", 0.3, 2.0),
    ),
    0.05,
    _trolley,
    mass=_trolley_mass,
    drives=(0,),
    often_long=OFTEN_LONG,
)
TWO_LINKS = Coupled(
    "links",
    Schema(
        _joints(("shoulder", "upper", "yaw"), ("elbow", "lower", "yaw")),
        (_force("shoulder_torque", "upper", "yaw"), _force("elbow_torque", "lower", "yaw")),
    ),
    (
        Parameter("upper_mass", "kg", 0.3, 1.5),
        Parameter("lower_mass", "kg", 0.4, 1.5),
        Parameter("damping", "N m s", 0.2, 1.0),
    ),
    0.03,
    _links,
    mass=_links_mass,
    often_long=OFTEN_LONG,
)
FLYER = Flyer(
    "flyer",
    Schema(
        (
            _state("x", "flyer", "position", "x"),
            _state("z", "flyer", "position", "z"),
            # It pitches in the plane of x and z, not about the vertical: another body.
            _state("pitch", "tilt", "angle", "yaw"),
            _state("vx", "flyer", "velocity", "x"),
            _state("vz", "flyer", "velocity", "z"),
            _state("pitch_vel", "tilt", "velocity", "yaw"),
        ),
        (Field("thrust", "N", "force", "body"), _force("torque", "tilt", "yaw")),
    ),
    (Parameter("mass", "kg", 0.3, 0.8), Parameter("inertia", "kg m^2", 0.1, 0.5)),
    0.05,
    _flyer,
    drives=(1, 2),
    often_long=OFTEN_LONG,
)
HULL = Integrated(
    "hull",
    Schema(
        (
            *_pose("hull"),
            _own("surge", "hull", "x"),
            _own("sway", "hull", "y"),
            _state("turn", "hull", "velocity", "yaw"),
        ),
        (_force("thrust", "hull", "x"), _force("moment", "hull", "yaw")),
    ),
    (
        Parameter("mass", "kg", 0.3, 1.5),
        Parameter("inertia", "kg m^2", 0.2, 1.0),
        Parameter("along", "N s/m", 0.3, 1.5),
        Parameter("across", "N s/m", 0.8, 4.0),
        Parameter("about", "N m s", 0.3, 1.5),
    ),
    0.1,
    _hull,
    _afloat,
    drives=(0, 2),
    often_long=OFTEN_LONG,
)
TWO_WHEELS = Integrated(
    "wheels",
    Schema(
        (*_pose("base"), _own("speed", "base", "x"), _state("turn", "base", "velocity", "yaw")),
        (
            Field("cmd_speed", "m/s", "velocity", "body", "base", "x"),
            Field("cmd_turn", "rad/s", "velocity", "body", "base", "yaw"),
        ),
    ),
    (Parameter("speed_time", "s", 0.1, 0.8), Parameter("turn_time", "s", 0.1, 0.8)),
    0.05,
    _wheels,
    _rolling,
    often_long=OFTEN_LONG,
)
COUPLED = (TROLLEY, TWO_LINKS, FLYER, HULL, TWO_WHEELS)
