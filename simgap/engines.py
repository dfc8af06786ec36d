"""The interface of a physics engine, whose step is not a JAX function.

An engine computes many rows at once. `simgap.simulators.tables` differentiates it numerically along an estimated
motion. The search then runs on these tables in JAX, and the engine itself confirms the result.
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
    """Physics that an engine can switch on by one constant c; off at c = 0.

    effect: id of the effect. where: joint or body that it acts on. outputs, channels: names of the states and commands
    concerned. constant, unit: name and unit of c as people read it. low, high: bounds of c. starts: values of c from
    which a search starts. says: a sentence for people with the constant's name in braces, true wherever the term acts.
    reciprocal: c is one over a limit, so that zero is no limit; `unit` is that of the limit. base: value of the
    constant where the term is off, to which c is added. shared: several places may share one constant. form: of the
    effect, if it has several.
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
    base: float = 0.0
    shared: bool = True
    form: str = ""


class Engine(Protocol):
    """A simulator that steps many rows at once, outside JAX. Rows do not depend on each other.

    Each joint is a body of its own in the schema (`Field.body`), with a position and a velocity along its axis; the
    velocities' `effort` is the unit of the force that `rows` applies there. Units are SI, angles rad.
    """

    @property
    def schema(self) -> Schema:
        """The columns of its recordings. States that recordings lack come last, with `observed=False`."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters phi, in order. Those that scale a value of the model are the logarithm of the scale."""
        ...

    @property
    def time_step(self) -> float:
        """Nominal interval between rows [s]."""
        ...

    @property
    def parts(self) -> int:
        """Number of equal parts of a row in which commands may differ."""
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
        """The next states, in double precision. May be called from several threads at once.

        effort: forces along the velocities that have an `effort`, in the order of the states, for the whole row. A row
        that diverges returns NaN; it raises nothing.
        """
        ...


class Table(NamedTuple):
    """An engine near a point, for each of many rows: the next state `then` at the point, with parameters and terms of
    zero, and the derivatives with respect to everything.

    A term may be far from zero, so it enters as a parabola. This is exact at zero and at the term's value at the
    point, and has the exact slope there. Units are those of `rows`.
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


def rough_of(engine: Engine) -> Engine:
    """A cheaper, less accurate version of the engine, from which derivatives are taken. An engine may have one, as its
    attribute `rough`; otherwise it is the engine itself."""
    return getattr(engine, "rough", engine)


def given_of(engine: Engine) -> Engine:
    """The engine as its user gave it. An engine that starts a search elsewhere has it as its attribute `given`."""
    return getattr(engine, "given", None) or engine


def no_effort(engine: Engine, rows: int) -> Float[np.ndarray, "n a"]:
    """Forces of zero, in the layout of `Engine.rows`."""
    return np.zeros((rows, sum(1 for f in engine.schema.state if f.effort)))


def split_of(engine: Engine, joint: str) -> tuple[Engine, ...]:
    """Rivals of the engine with a hidden state behind a joint (`Field.body`), such as play between motor and link.

    Each has the engine's parameters and terms, and one more term, the last, which must not be zero; its states are the
    engine's and then the hidden ones, which are zero where a session starts. An engine may have them, as its method
    `split`.
    """
    split = getattr(engine, "split", None)
    return () if split is None else tuple(split(joint))


class Behind(NamedTuple):
    """A hidden state behind a joint: the joint (`Field.body`), and id and form of the effect; see `split_of`."""

    joint: str
    effect: str
    form: str


def split_as(engine: Engine, behind: Behind) -> Engine:
    """The engine with this hidden state; ValueError where it has no such rival."""
    for rival in split_of(engine, behind.joint):
        if (rival.terms[-1].effect, rival.terms[-1].form) == (behind.effect, behind.form):
            return rival
    raise ValueError(f"it has no {behind.effect} of the {behind.form} behind {behind.joint}")


def is_engine(simulator: StepModel | Engine) -> TypeIs[Engine]:
    """Whether a simulator steps rows outside JAX."""
    return hasattr(simulator, "rows")
