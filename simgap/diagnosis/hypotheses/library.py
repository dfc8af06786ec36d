"""Functions that a nonparametric law may consist of: smooth functions of the robot's motion, place and commands.

Cosines of one quantity, products of two, one quantity times the sign of another, and plane waves over the ground.
"""

from collections.abc import Callable, Sequence
from itertools import combinations_with_replacement, pairwise, permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.hypotheses.features import seen, seen_names
from simgap.diagnosis.likelihood.problem import Problem, estimates
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.diagnosis.likelihood.variables import Variables
from simgap.layout import Layout, X, Y
from simgap.rows import by_row

WAVES = 8
"""Most half waves of one quantity over its range."""
SLOW_WAVES = 2
"""The same for a mean over the past: a line and a bow are enough."""
MEMORIES = (0.3, 1.0, 3.0)
"""Time constants [s] of means over the past."""
HEADINGS = tuple(np.arange(6) * np.pi / 6)
"""Directions [rad] of waves over the ground."""
SHORTEST, LENGTHS = 0.3, 10
"""Their shortest wavelength [m], and the number of wavelengths from there to twice the ground's extent."""
FAR = 4.0
"""Standard deviations at which a quantity in a product is clipped."""
STILL = 1e-6
"""Standard deviation up to which a quantity counts as constant."""
_Values = Float[np.ndarray, "... q"]


class Quantity(NamedTuple):
    """Something that a law may depend on; past: it is a mean over earlier rows; ground: the world axis of a place on
    the ground, else None."""

    name: str
    past: bool = False
    ground: int | None = None


class Function(NamedTuple):
    """One function of quantities: the names of its arguments, and its value from the values of all quantities."""

    depends_on: tuple[str, ...]
    of: Callable[[_Values], Float[np.ndarray, "..."]]


def quantities(layout: Layout) -> list[Quantity]:
    """The quantities that `values` returns, in its order."""
    moves, commands = _moving(layout), [f.name for f in layout.schema.command]
    names = seen_names(layout)
    places = [Quantity(layout.schema.state[i].name, ground=axis) for i, axis in _places(layout)]
    slow = [Quantity(f"the mean over {tau:g} s of {n}", past=True)
            for tau in MEMORIES for n in (*commands, *(names[i] for i in moves))]  # fmt: skip
    return [*map(Quantity, names), *places, *slow]


def values(problem: Problem, v: Variables) -> Float[np.ndarray, "C T-1 q"]:
    """All quantities in every row of the segments, from the estimated state."""
    layout, chunks = problem.augmented.layout, problem.chunks
    state = estimates(problem, v)
    command = np.asarray(chunks.command)[:, :-1]
    now = by_row(seen, layout, state, command)
    places = state[..., [i for i, _ in _places(layout)]]
    # Before a segment some commands are known, but no motion.
    sent, moved = sent_until(chunks), now[..., _moving(layout)]
    fading = np.exp(-problem.scales.time_step / np.array(MEMORIES))
    slow = [m for kept in fading for m in (_mean(sent, kept)[:, -command.shape[1] :], _mean(moved, kept))]
    return np.concatenate([now, places, *slow], axis=-1)


def sent_until(chunks: Chunks) -> Float[np.ndarray, "C h+T-1 u"]:
    """The commands before the segment and in every row but the last, earliest first."""
    return np.concatenate([np.asarray(chunks.past)[:, ::-1], np.asarray(chunks.command)[:, :-1]], axis=1)


def _moving(layout: Layout) -> list[int]:
    """Indices of the names that are velocities of a body."""
    return list(range(4 * len(layout.bodies)))


def _places(layout: Layout) -> list[tuple[int, int]]:
    """State index and axis of every place on the ground; x and y of a body are adjacent."""
    table = layout.position[:, [X, Y]]
    return [(int(i), axis) for columns in table for axis, i in zip((X, Y), columns, strict=True) if i >= 0]


def _mean(series: Float[np.ndarray, "C n q"], kept: float) -> Float[np.ndarray, "C n q"]:
    """Exponential moving average; `kept` is the share of the weights that is kept from row to row."""
    mean = np.array(series)
    for t in range(1, series.shape[1]):
        mean[:, t] = kept * mean[:, t - 1] + (1 - kept) * series[:, t]
    return mean


def dictionary(known: Sequence[Quantity], z: Float[np.ndarray, "n q"]) -> list[Function]:
    """Functions of the quantities that vary in these rows, each with zero mean there."""
    varying = [i for i in range(len(known)) if z[:, i].std() > STILL]
    present = [i for i in varying if not known[i].past]
    functions = [_wave(known, z, i, halves) for i in varying
                 for halves in range(1, 1 + (SLOW_WAVES if known[i].past else WAVES))]  # fmt: skip
    functions += [_product(known, z, i, j) for i, j in combinations_with_replacement(present, 2)]
    functions += [_by_sign(known, z, i, j) for i, j in permutations(present, 2) if known[i].ground is None]
    for i, j in pairwise(present):
        if (known[i].ground, known[j].ground) == (X, Y):
            functions += _over_ground(known, z, i, j)
    return [_without_mean(f, z) for f in functions]


def _wave(known: Sequence[Quantity], z: _Values, i: int, halves: int) -> Function:
    low, high = np.quantile(z[:, i], [0.01, 0.99])
    within = lambda z: np.clip((z[..., i] - low) / max(high - low, STILL), -0.1, 1.1)  # noqa: E731
    return Function((known[i].name,), lambda z: np.cos(np.pi * halves * within(z)))


def _standard(z: _Values, i: int) -> Callable[[_Values], Float[np.ndarray, "..."]]:
    mean, sd = z[:, i].mean(), z[:, i].std()
    return lambda z: np.clip((z[..., i] - mean) / sd, -FAR, FAR)


def _product(known: Sequence[Quantity], z: _Values, i: int, j: int) -> Function:
    one, other = _standard(z, i), _standard(z, j)
    return Function(tuple(dict.fromkeys((known[i].name, known[j].name))), lambda z: one(z) * other(z))


def _by_sign(known: Sequence[Quantity], z: _Values, i: int, j: int) -> Function:
    other = _standard(z, j)
    return Function((known[i].name, known[j].name), lambda z: np.sign(z[..., i]) * other(z))


def _over_ground(known: Sequence[Quantity], z: _Values, i: int, j: int) -> list[Function]:
    middle = z[:, [i, j]].mean(0)
    extent = max(np.ptp(z[:, i]), np.ptp(z[:, j]), SHORTEST)
    functions = []
    for heading in HEADINGS:
        along = np.array([np.cos(heading), np.sin(heading)])
        for length in np.geomspace(2 * extent, SHORTEST, LENGTHS):
            for wave in (np.cos, np.sin):
                turns = lambda z, k=2 * np.pi * along / length: (z[..., [i, j]] - middle) @ k  # noqa: E731
                names = (known[i].name, known[j].name)
                functions.append(Function(names, lambda z, wave=wave, turns=turns: wave(turns(z))))
    return functions


def _without_mean(function: Function, z: _Values) -> Function:
    mean = function.of(z).mean()
    return Function(function.depends_on, lambda z: function.of(z) - mean)
