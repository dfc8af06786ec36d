"""A machine of the training ground: its simulator, and the machine itself, which may have laws that this lacks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.ground.laws import Law
from simgap.types import Parameter, Schema

FINER = 10
"""Steps of the machine in a row, by the midpoint rule."""
STEPS = 2
"""Of its simulator in a row, by the classical Runge-Kutta rule: the two do not differ by their integrators."""
Acceleration = Callable[[Any, Any, Any, Any, Any], list[Any]]
"""(numpy or jax.numpy, parameters, positions, velocities, commands) -> acceleration of every velocity."""
Rates = Callable[[Any, Any, Any], list[Any]]
"""(numpy or jax.numpy, positions, velocities) -> rate of every position."""


@dataclass(frozen=True)
class Machine:
    """`StepModel`, and what the machine does in a row.

    Positions of all bodies and their velocities are in the order of the state, in which what is not recorded is last.
    """

    name: str
    schema: Schema
    parameters: tuple[Parameter, ...]
    time_step: float
    drives: tuple[int, ...] = field(default=(), kw_only=True)
    """Of every command, which of the velocities it drives; if none is given, each drives its own."""
    often_long: float = field(default=0.5, kw_only=True)
    """Share of the cases with long recordings."""

    @cached_property
    def positions(self) -> list[int]:
        """Which of the states are positions."""
        return [i for i, f in enumerate(self.schema.state) if f.kind != "velocity"]

    @cached_property
    def velocities(self) -> list[int]:
        """Which of the states are velocities."""
        return [i for i, f in enumerate(self.schema.state) if f.kind == "velocity"]

    @cached_property
    def driven(self) -> list[int]:
        """Of every command, which of the velocities it drives."""
        return [*self.drives] or [*range(len(self.schema.command))]

    @property
    def start(self) -> Float[np.ndarray, " s"]:
        """The state at rest in which sessions begin."""
        return np.zeros(len(self.schema.state))

    @property
    def sizes(self) -> tuple[float, float]:
        """Sizes of laws, as shares of usual commands and speeds, from and to."""
        return 0.01, 0.5

    @property
    def usual(self) -> Float[np.ndarray, " v"]:
        """Usual speeds, in the order of the velocities: the laws' unit."""
        return np.ones(len(self.velocities))

    def of_velocities(self, change: Float[np.ndarray, " v"]) -> Float[np.ndarray, " s"]:
        """A change of the velocities as one of the state."""
        state = np.zeros(len(self.schema.state))
        state[self.velocities] = change
        return state

    def drawn(self, rng: np.random.Generator) -> Float[np.ndarray, " p"]:
        """Parameters, anywhere in the inner two thirds of their ranges."""
        return np.array([p.low + (p.high - p.low) * rng.uniform(1 / 6, 5 / 6) for p in self.parameters])

    def sent(self, drawn: Float[np.ndarray, " u"], state: Float[np.ndarray, " s"]) -> Float[np.ndarray, " u"]:  # noqa: ARG002
        """The command that is sent in a state, from one of a size near one."""
        return drawn

    def shown(self, state: Float[np.ndarray, " s"], laws: Sequence[Law]) -> Float[np.ndarray, " s"]:
        """What sensors show of the state, once a row."""
        shown = state.copy()
        for law in laws:
            shown[self.velocities] = self.usual * law.read(shown[self.velocities] / self.usual, self.time_step)
        return shown

    def step(
        self, params: Float[Array, " p"], state: Float[Array, " s"], command: Float[Array, " u"]
    ) -> Float[Array, " s"]:
        """The next state by the simulator."""
        raise NotImplementedError

    def row(
        self,
        params: Float[np.ndarray, " p"],
        state: Float[np.ndarray, " s"],
        sent: Float[np.ndarray, " u"],
        laws: Sequence[Law],
    ) -> Float[np.ndarray, " s"]:
        """The machine's state a row later."""
        raise NotImplementedError

    def rate(self, params: Float[np.ndarray, " p"]) -> float:
        """Acceleration per unit of command, at rest [1/s^2 or 1/s]."""
        raise NotImplementedError


@dataclass(frozen=True)
class Integrated(Machine):
    """A machine whose accelerations are given."""

    acceleration: Acceleration
    rates: Rates = lambda _, position, velocity: [velocity[i] for i in range(len(position))]

    def step(
        self, params: Float[Array, " p"], state: Float[Array, " s"], command: Float[Array, " u"]
    ) -> Float[Array, " s"]:
        """See `Machine`."""
        h = self.time_step / STEPS
        slope = lambda at: jnp.stack(self.derivative(jnp, params, at, command))  # noqa: E731
        for _ in range(STEPS):
            first = slope(state)
            second = slope(state + h / 2 * first)
            third = slope(state + h / 2 * second)
            fourth = slope(state + h * third)
            state = state + h / 6 * (first + 2 * second + 2 * third + fourth)
        return state

    def row(
        self,
        params: Float[np.ndarray, " p"],
        state: Float[np.ndarray, " s"],
        sent: Float[np.ndarray, " u"],
        laws: Sequence[Law],
    ) -> Float[np.ndarray, " s"]:
        """See `Machine`."""
        h = self.time_step / FINER
        commanded = np.zeros(len(self.velocities))
        commanded[self.driven] = sent
        for _ in range(FINER):
            arrives = commanded
            for law in laws:
                arrives = law.command(arrives, h)
            v = state[self.velocities]
            push = sum((law.push(state[self.positions], v, arrives, h) for law in laws), np.zeros(len(v)))
            acts = arrives[self.driven]
            middle = state + h / 2 * np.array(self.derivative(np, params, state, acts, push))
            state = state + h * np.array(self.derivative(np, params, middle, acts, push))
        return state

    def pushed(self, params: Any, q: Any, push: Any) -> Any:  # noqa: ARG002
        """Accelerations by what laws push with."""
        return push

    def rate(self, params: Float[np.ndarray, " p"]) -> float:
        """See `Machine`."""
        rest = self.start
        command = np.eye(len(self.schema.command))[0]
        position, velocity = rest[self.positions], rest[self.velocities]
        at = [np.array(self.acceleration(np, params, position, velocity, u)) for u in (command, 0 * command)]
        return float(np.abs(at[0] - at[1]).max())

    def derivative(self, xp: Any, params: Any, state: Any, command: Any, push: Any = None) -> list[Any]:
        """Of the state by time, with `xp` for numpy; laws may `push`."""
        q, v = [state[i] for i in self.positions], [state[i] for i in self.velocities]
        acceleration = self.acceleration(xp, params, q, v, command)
        if push is not None:
            acceleration = [a + p for a, p in zip(acceleration, self.pushed(params, q, push), strict=True)]
        slopes = dict(zip([*self.positions, *self.velocities], [*self.rates(xp, q, v), *acceleration], strict=True))
        return [slopes[i] for i in range(len(state))]
