"""A simulator with the parameters that a diagnosis fitted as its nominal ones."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np
from jaxtyping import Array, Float

from simgap.effects.augmented import Augmented
from simgap.types import Parameter, Schema, Simulator, StepModel


@dataclass(frozen=True)
class Refitted:
    """`simulator` with other nominal values of its parameters; as a `Simulator`, where it is one."""

    simulator: StepModel
    nominal: tuple[float, ...]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The simulator's own, in their own ranges."""
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


def nominal(simulator: StepModel) -> Float[np.ndarray, " p"]:
    """The parameters that a simulator is used with as it is: of one that a diagnosis gave, the fitted ones."""
    return Augmented(simulator).nominal
