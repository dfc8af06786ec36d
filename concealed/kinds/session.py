"""Sessions of a machine: B of them side by side, driven by somebody, with what its user's simulator lacks."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concealed.form import Array
from concealed.kinds.robots import Kind

FINE = 20
"""Steps of a row, by the midpoint rule."""

Pushes = Callable[[Array, Array], Array]
"""(states [B, s], what the motors get [B, u]) -> further forces [B, v]."""
Sees = Callable[[Array], Array]
"""(states [B, s]) -> what sensors show of them, but for their noise."""


class Traits(NamedTuple):
    """What a machine has that its user's simulator lacks.

    late, lag [s]: of all commands. leak [u, u]: what each command adds to the others. band, limit [u]: below which a
    command does nothing, beyond which no more. push: further forces. sees: what sensors show. old: rows by which
    velocities that are measured are late.
    """

    late: float = 0.0
    lag: float = 0.0
    leak: Array | None = None
    band: Array | None = None
    limit: Array | None = None
    push: Pushes | None = None
    sees: Sees | None = None
    old: int = 0


PLAIN = Traits()


class Chance(NamedTuple):
    """All that is drawn of T rows of B sessions: goals [T, B, g], and standard normal numbers for the trembling hand
    [T, B, u], for what disturbs the states and for what is measured [T, B, s]."""

    goals: Array
    hand: Array
    disturbed: Array
    measured: Array


def chance(of: Kind, sessions: int, rows: int, rng: np.random.Generator) -> Chance:
    """Goals that are kept for a while, and noise."""
    goals = np.empty((rows, sessions, len(of.goal)))
    for b in range(sessions):
        row = 0
        while row < rows:
            lasts = max(1, round(rng.uniform(*of.lasts) / of.interval))
            # Now and then nothing is asked of an axis.
            goals[row : row + lasts, b] = of.goal * rng.uniform(-1, 1, len(of.goal)) * (rng.random(len(of.goal)) < 0.8)
            row += lasts
    normal = lambda width: rng.normal(size=(rows, sessions, width))  # noqa: E731
    states = len(of.columns.state)
    return Chance(goals, normal(len(of.columns.command)), normal(states), normal(states))


class Recorded(NamedTuple):
    """Measured states and commands [T, B, ...]."""

    measured: Array
    command: Array


def record(of: Kind, p: Array, traits: Traits, luck: Chance, level: float) -> Recorded:
    """T rows of a machine with parameters `p`, at a level of noise."""
    rows, sessions, states = luck.measured.shape
    noise, shaken = level * of.measured, level * of.disturbed
    true, measured = np.empty((rows, sessions, states)), np.empty((rows, sessions, states))
    sent, x = np.empty(luck.hand.shape), np.zeros((sessions, states))
    lagging = sent[0]
    for t in range(rows):
        true[t] = x
        y = shown(of, traits, true[: t + 1]) + noise * luck.measured[t]
        sent[t] = of.drives(luck.goals[t], y) + of.tremble * luck.hand[t]
        measured[t] = wrapped(of, y)
        lagging = lagging if t else sent[0]
        x, lagging = row(of, p, x, traits, sent[: t + 1], lagging)
        x = x + shaken * luck.disturbed[t]
    return Recorded(measured, sent)


def wrapped(of: Kind, states: Array) -> Array:
    """With angles between -pi and pi."""
    return np.where(of.turns, (states + np.pi) % (2 * np.pi) - np.pi, states)


def shown(of: Kind, traits: Traits, so_far: Array) -> Array:
    """What sensors show of the last of the states so far [T, B, s]."""
    now = so_far[-1] if traits.sees is None else traits.sees(so_far[-1])
    old = so_far[max(len(so_far) - 1 - traits.old, 0)]
    return np.concatenate([now[:, : -of.rates], old[:, -of.rates :]], 1) if traits.old else now


def row(of: Kind, p: Array, x: Array, traits: Traits, sent: Array, lagging: Array) -> tuple[Array, Array]:
    """The states a row later, and what has come through the lag. sent: all commands so far [T, B, u]."""
    h, nothing = of.interval / FINE, np.zeros((len(x), of.rates))
    for k in range(FINE):
        rows_ago = int(np.ceil(max(traits.late - k * h, 0.0) / of.interval - 1e-9))
        u = sent[max(len(sent) - 1 - rows_ago, 0)]
        if traits.lag:
            u = lagging = lagging + (1 - np.exp(-h / traits.lag)) * (u - lagging)
        if traits.leak is not None:
            u = u + u @ traits.leak.T
        if traits.band is not None:
            u = np.sign(u) * np.maximum(np.abs(u) - traits.band, 0.0)
        if traits.limit is not None:
            u = np.clip(u, -traits.limit, traits.limit)
        middle = x + h / 2 * of.moves(p, x, u, traits.push(x, u) if traits.push else nothing)
        x = x + h * of.moves(p, middle, u, traits.push(middle, u) if traits.push else nothing)
    return x, lagging
