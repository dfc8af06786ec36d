"""What a diagnosis needs of a physics engine, whose step is no function of JAX's.

An engine computes many rows at once. `simgap.simulators.tables` differences it along an estimated motion, and a whole
search then runs on these tables in JAX; the engine itself confirms what the search ends with.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from jaxtyping import Array, Float

from simgap.types import Parameter, Schema, StepModel

if TYPE_CHECKING:
    from typing_extensions import TypeIs


@dataclass(frozen=True)
class Term:
    """Physics that an engine can switch on by one constant c; nil at c = 0.

    effect: id of the vocabulary. where: joint or body that it acts on. outputs, channels: names of the states and
    commands concerned. constant, unit: of c as people read it. low, high: bounds of c. starts: sizes of c at which a
    search begins. says: a sentence for people with the constant's name in braces, which holds wherever the term acts.
    reciprocal: c is one over a limit, so that nil is no limit; `unit` is the limit's. shared: the term may have one
    constant at several places.
    """

    effect: str
    where: str
    outputs: tuple[str, ...]
    channels: tuple[str, ...]
    constant: str
    unit: str
    low: float
    high: float
    starts: tuple[float, ...]
    says: str
    reciprocal: bool = False
    shared: bool = True


class Engine(Protocol):
    """A simulator that steps many rows at once, outside JAX; rows do not depend on each other.

    Each joint is a body of its own in the schema (`Field.body`), with a position and a velocity along its axis; the
    velocities' `effort` is the unit of the force that `rows` applies there. Units are SI, angles rad.
    """

    @property
    def schema(self) -> Schema:
        """The columns of its recordings; states that these lack come last, with `observed=False`."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters phi, in order; those that scale a value of the model are logarithms of the scale."""
        ...

    @property
    def time_step(self) -> float:
        """Nominal interval between rows [s]."""
        ...

    @property
    def parts(self) -> int:
        """Equal parts of a row in which commands may differ."""
        ...

    @property
    def terms(self) -> tuple[Term, ...]:
        """Physics that can be switched on, in order."""
        ...

    def rows(
        self,
        phi: Float[np.ndarray, " p"],
        terms: Float[np.ndarray, "n k"],
        state: Float[np.ndarray, "n s"],
        command: Float[np.ndarray, "n parts u"],
        effort: Float[np.ndarray, "n a"],
    ) -> Float[np.ndarray, "n s"]:
        """The next states, in double precision; may be called from several threads at once.

        effort: forces along the velocities that have an `effort`, in the order of the states, for the whole row. A row
        that leaves the finite numbers is not a number; it raises nothing.
        """
        ...


class Table(NamedTuple):
    """Of each of many rows, what an engine does near a point: the next state `then` at the point, for parameters and
    terms of zero, and the derivatives by everything.

    Of a term, of which there may be much or none, it is a parabola: right at none of it and at what it is at the point,
    and there in its slope as well. Units are those of `rows`.
    """

    state: Float[Array | np.ndarray, "... s"]
    command: Float[Array | np.ndarray, "... parts u"]
    then: Float[Array | np.ndarray, "... s"]
    by_state: Float[Array | np.ndarray, "... s s"]
    by_command: Float[Array | np.ndarray, "... parts*u s"]
    by_phi: Float[Array | np.ndarray, "... p s"]
    by_effort: Float[Array | np.ndarray, "... a s"]
    by_term: Float[Array | np.ndarray, "... k s"]
    by_term_squared: Float[Array | np.ndarray, "... k s"]


def is_engine(simulator: StepModel | Engine) -> TypeIs[Engine]:
    """Whether a simulator steps rows outside JAX."""
    return hasattr(simulator, "rows")
