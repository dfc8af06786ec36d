"""Tables of an engine along an estimated motion: next states, and their derivatives by finite differences.

The engine is evaluated once per row; the search then uses the tables thousands of times.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from simgap.engines import Engine, Table, no_effort, rough_of
from simgap.threads import side_by_side

STEP = 1e-3
"""Difference step of a state or a command, as a share of its standard deviation; in double precision."""
LOG_STEP = 1e-3
"""Difference step of a parameter, which is a logarithm; of a term, as a share of its value."""
EFFORT = 1e-3
"""Difference step of an effort [N m or N]. Engines are linear in efforts, except at contacts and limits."""
LEAST = 1e-6
"""Smallest difference step of a state or a command, for one that does not vary."""


class Points(NamedTuple):
    """Where an engine is tabulated: parameters, and rows of terms, states and commands."""

    phi: Float[np.ndarray, " p"]
    terms: Float[np.ndarray, "n k"]
    state: Float[np.ndarray, "n s"]
    command: Float[np.ndarray, "n parts u"]


class Inputs(NamedTuple):
    """Which inputs vary in what a table is made for; states and parameters always do. terms: each term."""

    commands: bool
    efforts: bool
    terms: Bool[np.ndarray, " k"]


def tabulate(engine: Engine, points: Points, varied: Inputs | None = None) -> Table:
    """The engine near these points, in single precision. Where it diverges, derivatives are zero and the next state is
    the state itself.

    varied: the inputs that get derivatives (None: all). Those of the others are zero, because each takes another
    evaluation of all rows. Differences are one-sided; their error is far below that of a linear table. They are those
    of the engine's `rough_of`.
    """
    points = Points(*(np.asarray(a, np.float64) for a in points))
    phi, terms, state, command = points
    none = no_effort(engine, len(state))
    then = engine.rows(phi, terms, state, command, none)
    rough = rough_of(engine)
    rough_then = then if rough is engine else rough.rows(phi, terms, state, command, none)
    varied = varied or Inputs(True, True, np.ones(terms.shape[1], bool))
    spread = np.maximum(STEP * state.std(0), LEAST), np.maximum(STEP * command.std((0, 1)), LEAST)
    zero = np.zeros_like(state)

    def difference(moved: tuple[Points, float]) -> Float[np.ndarray, "n s"]:
        at, step = moved
        return (rough.rows(*at, none) - rough_then) / step

    def effort_column(i: int) -> Float[np.ndarray, "n s"]:
        return by_effort(rough, points, rough_then, i)

    def term_columns(i: int) -> tuple[Float[np.ndarray, "n s"], Float[np.ndarray, "n s"]]:
        return _by_term(rough, points, i, rough_then, none) if varied.terms[i] else (zero, zero)

    parts = [(j, i) for j in range(engine.parts) for i in range(command.shape[2])]
    states = [(points._replace(state=_moved(state, i, h)), h) for i, h in enumerate(spread[0])]
    commands = [
        (points._replace(command=_moved(command, at, h)), h)
        for at, h in zip(parts, np.tile(spread[1], engine.parts), strict=True)
        if varied.commands
    ]
    phis = [(points._replace(phi=_moved(phi, i, LOG_STEP)), LOG_STEP) for i in range(len(phi))]
    efforts = range(none.shape[1])
    parabolas = side_by_side(term_columns, range(terms.shape[1]))
    columns = [
        side_by_side(difference, states),
        side_by_side(difference, commands) if varied.commands else [zero] * len(parts),
        side_by_side(difference, phis),
        side_by_side(effort_column, efforts) if varied.efforts else [zero] * len(efforts),
        *([parabola[order] for parabola in parabolas] for order in (0, 1)),
    ]
    columns = [_stacked(c, state) for c in columns]
    return _table(points, then, columns)


def shifted(engine: Engine, points: Points, table: Table) -> Table:
    """The engine at these points, with the derivatives of a table that was made nearby."""
    points = Points(*(np.asarray(a, np.float64) for a in points))
    then = engine.rows(*points, np.zeros((len(points.state), table.by_effort.shape[1])))
    return _table(points, then, [np.asarray(column, np.float64) for column in table[3:]])


def _table(points: Points, then: Float[np.ndarray, "n s"], columns: list[np.ndarray]) -> Table:
    """The table through the next states `then`, with columns of derivatives in the order of `Table`."""
    phi, terms, state, command = points
    of_terms = np.einsum("nk,nks->ns", terms, columns[4]) + np.einsum("nk,nks->ns", terms**2, columns[5])
    at_nil = then - np.einsum("p,nps->ns", phi, columns[2]) - of_terms
    at_nil = np.where(np.isfinite(at_nil), at_nil, state)
    return Table(*(np.asarray(a, np.float32) for a in (state, command, at_nil, *columns)))


def by_effort(engine: Engine, points: Points, then: Float[np.ndarray, "n s"], i: int) -> Float[np.ndarray, "n s"]:
    """Derivatives of the next states, which are `then` without efforts, with respect to the i-th effort."""
    effort = no_effort(engine, len(then))
    effort[:, i] = EFFORT
    return (engine.rows(*points, effort) - then) / EFFORT


def _by_term(
    engine: Engine, points: Points, i: int, then: Float[np.ndarray, "n s"], none: Float[np.ndarray, "n a"]
) -> tuple[Float[np.ndarray, "n s"], Float[np.ndarray, "n s"]]:
    """The two coefficients of a parabola in a term: through zero and the term's value, with the slope at that value.

    Where the value is zero: of the line to the first of the term's `starts`.
    """
    there = points.terms[:, i]
    acts = there != 0
    size = np.where(acts, there, engine.terms[i].starts[0])

    def missed(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n s"]:
        """`then` minus the next states where the term has these values."""
        terms = np.array(points.terms)
        terms[:, i] = values
        return then - engine.rows(points.phi, terms, points.state, points.command, none)

    chord = missed(np.where(acts, 0.0, size)) / np.where(acts, size, -size)[:, None]
    if not acts.any():
        return chord, np.zeros_like(chord)
    slope = missed((1 - LOG_STEP) * there) / (LOG_STEP * size)[:, None]
    bend = np.where(acts, 1 / size, 0.0)[:, None] * (slope - chord)
    return chord - bend * size[:, None], bend


def _moved(values: np.ndarray, index, by: float) -> np.ndarray:
    """A copy with one column, or one entry of a vector, changed."""
    values = np.array(values)
    values[(..., *np.atleast_1d(index))] += by
    return values


def _stacked(columns: list[np.ndarray], state: np.ndarray) -> Float[np.ndarray, "n c s"]:
    """Columns side by side, zero where they are not finite."""
    found = np.stack(columns, axis=1) if columns else np.zeros((len(state), 0, state.shape[1]))
    return np.where(np.isfinite(found), found, 0.0)
