"""Machines of the training ground: what their simulator knows, for the simulator and for the machine itself.

A machine's units are such that usual speeds and commands are near one. Its simulator takes `STEPS` Runge-Kutta
steps a row: the machine, which takes more, does not differ by its integrator.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.types import Axis, Field, Kind, Parameter, Schema

STEPS = 2
"""Of a row, by the classical Runge-Kutta rule."""
Acceleration = Callable[[Any, Any, Any, Any, Any], list[Any]]
"""(numpy or jax.numpy, parameters, positions, velocities, commands) -> acceleration of every velocity."""
Rates = Callable[[Any, Any, Any], list[Any]]
"""(numpy or jax.numpy, positions, velocities) -> rate of every position."""


def _as_they_are(_: Any, position: Any, velocity: Any) -> list[Any]:
    return [velocity[i] for i in range(len(position))]


@dataclass(frozen=True)
class Machine:
    """A simulator of the training ground: `StepModel`.

    Positions of all bodies and their velocities are in the order of the state, in which what is not recorded is last.
    """

    name: str
    schema: Schema
    parameters: tuple[Parameter, ...]
    time_step: float
    acceleration: Acceleration
    rates: Rates = _as_they_are

    @cached_property
    def positions(self) -> list[int]:
        """Which of the states are positions."""
        return [i for i, f in enumerate(self.schema.state) if f.kind != "velocity"]

    @cached_property
    def velocities(self) -> list[int]:
        """Which of the states are velocities."""
        return [i for i, f in enumerate(self.schema.state) if f.kind == "velocity"]

    def of_velocities(self, change: Float[np.ndarray, " v"]) -> Float[np.ndarray, " s"]:
        """A change of the velocities as one of the state."""
        state = np.zeros(len(self.schema.state))
        state[self.velocities] = change
        return state

    def step(
        self, params: Float[Array, " p"], state: Float[Array, " s"], command: Float[Array, " u"]
    ) -> Float[Array, " s"]:
        """The next state."""
        h = self.time_step / STEPS
        slope = lambda at: jnp.stack(self.derivative(jnp, params, at, command))  # noqa: E731
        for _ in range(STEPS):
            first = slope(state)
            second = slope(state + h / 2 * first)
            third = slope(state + h / 2 * second)
            fourth = slope(state + h * third)
            state = state + h / 6 * (first + 2 * second + 2 * third + fourth)
        return state

    def derivative(self, xp: Any, params: Any, state: Any, command: Any, pushed: Any = None) -> list[Any]:
        """Of the state by time, with `xp` for numpy; `pushed` is added to the accelerations."""
        q, v = [state[i] for i in self.positions], [state[i] for i in self.velocities]
        acceleration = self.acceleration(xp, params, q, v, command)
        if pushed is not None:
            acceleration = [a + p for a, p in zip(acceleration, pushed, strict=True)]
        slopes = dict(zip([*self.positions, *self.velocities], [*self.rates(xp, q, v), *acceleration], strict=True))
        return [slopes[i] for i in range(len(state))]


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

CART = Machine(
    "cart", _single("force"), (Parameter("drive", "1/kg", 1.0, 9.0), Parameter("damping", "1/s", 0.5, 6.0)), 0.05, _cart
)
SERVO = Machine(
    "servo",
    _single("position"),
    (Parameter("stiffness", "1/s^2", 40.0, 400.0), Parameter("damping", "1/s", 5.0, 30.0)),
    0.02,
    _servo,
)
PENDULUM = Machine(
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
PAIR = Machine(
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
PAIR_LEFT = Machine(
    "pair_left",
    Schema((*_LEFT, *(replace(f, observed=False) for f in _RIGHT)), _PUSHED),
    # Without a spring nothing that is recorded would tell of the other body.
    (*PAIR.parameters[:2], Parameter("spring", "1/s^2", 5.0, 20.0)),
    PAIR.time_step,
    _pair,
)
BASE = Machine(
    "base",
    _BASE,
    (Parameter("response", "1/s", 1.0, 10.0), Parameter("turning", "1/s", 1.0, 10.0)),
    0.1,
    _base,
    _turned,
)
ARM = Machine(
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


def _without_speeds(machine: Machine) -> Machine:
    """The same machine, with recordings of its positions only."""
    state = tuple(replace(f, observed=f.kind != "velocity") for f in machine.schema.state)
    return replace(machine, name=f"{machine.name}_positions", schema=Schema(state, machine.schema.command))


MACHINES = (CART, SERVO, PENDULUM, PAIR, BASE, ARM, *map(_without_speeds, (SERVO, PENDULUM, ARM)), PAIR_LEFT)
