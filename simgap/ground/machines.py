"""Machines of the training ground: what their simulators know.

Units of the small ones are such that usual speeds and commands are near one.
"""

from dataclasses import replace
from typing import Any

from simgap.ground.coupled import COUPLED
from simgap.ground.machine import Integrated, Machine
from simgap.ground.spot import SPOT
from simgap.types import Axis, Field, Kind, Parameter, Schema


def _axis(name: str, body: str, axis: Axis = "x") -> tuple[Field, Field]:
    """Position and velocity of a body along one axis."""
    return (
        Field(f"{name}_pos", "m", "position", "world", body, axis),
        Field(f"{name}_vel", "m/s", "velocity", "world", body, axis),
    )


def _command(name: str, body: str, kind: Kind = "force", axis: Axis = "x") -> Field:
    unit = {"force": "N", "position": "m", "velocity": "m/s"}[kind]
    return Field(f"cmd_{name}", unit, kind, "world", body, axis)


def _single(kind: Kind) -> Schema:
    return Schema(_axis("slide", "slide"), (_command("slide", "slide", kind),))


def _cart(_: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:  # noqa: ARG001
    drive, damping = p
    return [drive * u[0] - damping * v[0]]


def _servo(_: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:
    stiffness, damping = p
    return [stiffness * (u[0] - q[0]) - damping * v[0]]


def _pendulum(xp: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:
    drive, damping, weight = p
    return [drive * u[0] - damping * v[0] - weight * xp.sin(q[0])]


def _pair(_: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:
    drive, damping, spring = p
    pull = spring * (q[1] - q[0])
    return [drive * u[0] - damping * v[0] + pull, drive * u[1] - damping * v[1] - pull]


def _arm(xp: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:
    """Three geared joints in a vertical plane: gravity turns each by what hangs on it."""
    stiffness, damping, weight = p
    lever = [xp.sin(q[0]), xp.sin(q[0] + q[1]), xp.sin(q[0] + q[1] + q[2])]
    hangs = [3 * lever[0] + 2 * lever[1] + lever[2], 2 * lever[1] + lever[2], lever[2]]
    return [stiffness * (u[i] - q[i]) - damping * v[i] - weight * hangs[i] for i in range(3)]


def _base(_: Any, p: Any, q: Any, v: Any, u: Any) -> list[Any]:  # noqa: ARG001
    response, turning = p
    return [response * (u[0] - v[0]), response * (u[1] - v[1]), turning * (u[2] - v[2])]


def _turned(xp: Any, q: Any, v: Any) -> list[Any]:
    """Rates of a pose whose velocity is along the body's own axes."""
    sine, cosine = xp.sin(q[2]), xp.cos(q[2])
    return [cosine * v[0] - sine * v[1], sine * v[0] + cosine * v[1], v[2]]


def _joint(name: str) -> tuple[Field, Field, Field]:
    """Angle, speed and commanded angle of a joint."""
    return (
        Field(f"{name}_pos", "rad", "position", "body", name, "yaw"),
        Field(f"{name}_vel", "rad/s", "velocity", "body", name, "yaw"),
        Field(f"cmd_{name}", "rad", "position", "body", name, "yaw"),
    )


_ARM = tuple(map(_joint, ("shoulder", "elbow", "wrist")))
_LEFT, _RIGHT = _axis("left", "left"), _axis("right", "right")
_PUSHED = (_command("left", "left"), _command("right", "right"))
_BASE = Schema(
    (
        Field("x", "m", "position", "world", "base", "x"),
        Field("y", "m", "position", "world", "base", "y"),
        Field("yaw", "rad", "angle", "world", "base", "yaw"),
        Field("vx", "m/s", "velocity", "body", "base", "x"),
        Field("vy", "m/s", "velocity", "body", "base", "y"),
        Field("wz", "rad/s", "velocity", "body", "base", "yaw"),
    ),
    (
        Field("cmd_vx", "m/s", "velocity", "body", "base", "x"),
        Field("cmd_vy", "m/s", "velocity", "body", "base", "y"),
        Field("cmd_wz", "rad/s", "velocity", "body", "base", "yaw"),
    ),
)

CART = Integrated(
    "cart", _single("force"), (Parameter("drive", "1/kg", 1.0, 9.0), Parameter("damping", "1/s", 0.5, 6.0)), 0.05, _cart
)
SERVO = Integrated(
    "servo",
    _single("position"),
    (Parameter("stiffness", "1/s^2", 40.0, 400.0), Parameter("damping", "1/s", 5.0, 30.0)),
    0.02,
    _servo,
)
PENDULUM = Integrated(
    "pendulum",
    _single("force"),
    (
        Parameter("drive", "1/kg", 2.0, 18.0),
        Parameter("damping", "1/s", 0.5, 6.0),
        Parameter("weight", "m/s^2", 1.0, 15.0),
    ),
    0.02,
    _pendulum,
)
PAIR = Integrated(
    "pair",
    Schema((_LEFT[0], _RIGHT[0], _LEFT[1], _RIGHT[1]), _PUSHED),
    (
        Parameter("drive", "1/kg", 1.0, 9.0),
        Parameter("damping", "1/s", 0.5, 6.0),
        Parameter("spring", "1/s^2", 0.0, 20.0),
    ),
    0.05,
    _pair,
)
PAIR_LEFT = Integrated(
    "pair_left",
    Schema((*_LEFT, *(replace(f, observed=False) for f in _RIGHT)), _PUSHED),
    # Without a spring nothing that is recorded would tell of the other body.
    (*PAIR.parameters[:2], Parameter("spring", "1/s^2", 5.0, 20.0)),
    PAIR.time_step,
    _pair,
)
BASE = Integrated(
    "base",
    _BASE,
    (Parameter("response", "1/s", 1.0, 10.0), Parameter("turning", "1/s", 1.0, 10.0)),
    0.1,
    _base,
    _turned,
)
ARM = Integrated(
    "arm",
    Schema(
        (*(position for position, _, _ in _ARM), *(velocity for _, velocity, _ in _ARM)),
        tuple(command for _, _, command in _ARM),
    ),
    (
        Parameter("stiffness", "1/s^2", 40.0, 400.0),
        Parameter("damping", "1/s", 5.0, 30.0),
        Parameter("weight", "1/s^2", 1.0, 10.0),
    ),
    0.02,
    _arm,
)


def _without_speeds(machine: Integrated) -> Integrated:
    """The same machine, with recordings of its positions only."""
    state = tuple(replace(f, observed=f.kind != "velocity") for f in machine.schema.state)
    return replace(machine, name=f"{machine.name}_positions", schema=Schema(state, machine.schema.command))


SMALL = (CART, SERVO, PENDULUM, PAIR, BASE, ARM, *map(_without_speeds, (SERVO, PENDULUM, ARM)), PAIR_LEFT)
MACHINES: tuple[Machine, ...] = (*SMALL, SPOT, *COUPLED)
