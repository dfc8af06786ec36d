"""A simulator whose nominal parameters are those that a diagnosis fitted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, TypeVar, cast

import numpy as np
from jaxtyping import Array, Float

from simgap.effects.augmented import Augmented
from simgap.engines import Engine, Term, is_engine
from simgap.types import Parameter, Schema, Simulator, StepModel

Kind = TypeVar("Kind", bound=StepModel | Engine)


@dataclass(frozen=True)
class _Fitted(Generic[Kind]):
    """`simulator` with other nominal values of its parameters; subclasses add how it steps."""

    simulator: Kind
    nominal: tuple[float, ...]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The simulator's own, with the new nominal values clipped to their ranges."""
        pairs = zip(self.simulator.parameters, self.nominal, strict=True)
        return tuple(replace(p, nominal=float(np.clip(value, p.low, p.high))) for p, value in pairs)

    @property
    def schema(self) -> Schema:
        """The simulator's own."""
        return self.simulator.schema

    @property
    def time_step(self) -> float:
        """The simulator's own [s]."""
        return self.simulator.time_step


@dataclass(frozen=True)
class Refitted(_Fitted[StepModel]):
    """A simulator that steps in JAX; a `Simulator` where the original is one."""

    def step(
        self, params: Float[Array, " p"], state: Float[Array, " s"], command: Float[Array, " u"]
    ) -> Float[Array, " s"]:
        """The simulator's own."""
        return self.simulator.step(params, state, command)

    def to_body(self, state: Float[Array, " s"]) -> Float[Array, " s"]:
        """The simulator's own."""
        return cast(Simulator, self.simulator).to_body(state)

    def from_body(self, body: Float[Array, " s"]) -> Float[Array, " s"]:
        """The simulator's own."""
        return cast(Simulator, self.simulator).from_body(body)


@dataclass(frozen=True)
class RefittedEngine(_Fitted[Engine]):
    """A simulator that steps many rows outside JAX, as an `Engine`."""

    @property
    def parts(self) -> int:
        """The engine's own."""
        return self.simulator.parts

    @property
    def terms(self) -> tuple[Term, ...]:
        """The engine's own."""
        return self.simulator.terms

    def rows(
        self,
        phi: Float[np.ndarray, " p"],
        terms: Float[np.ndarray, "n k"],
        state: Float[np.ndarray, "n s"],
        command: Float[np.ndarray, "n parts u"],
        effort: Float[np.ndarray, "n a"],
    ) -> Float[np.ndarray, "n s"]:
        """The engine's own."""
        return self.simulator.rows(phi, terms, state, command, effort)


def refitted(simulator: StepModel | Engine, phi: Sequence[float]) -> Refitted | RefittedEngine:
    """The simulator with these values of its parameters as the nominal ones."""
    nominal = tuple(map(float, phi))
    return RefittedEngine(simulator, nominal) if is_engine(simulator) else Refitted(simulator, nominal)


def nominal(simulator: StepModel | Engine) -> Float[np.ndarray, " p"]:
    """A simulator's nominal parameters; for one that a diagnosis returned, these are the fitted ones."""
    return Augmented(simulator).nominal
