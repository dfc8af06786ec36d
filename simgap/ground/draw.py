"""A case of the training ground, drawn from its number: a machine, what it has and its simulator lacks, recordings."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.ground.commands import drawn_commands
from simgap.ground.families import FAMILIES
from simgap.ground.laws import Law, Uneven
from simgap.ground.machine import Machine
from simgap.ground.machines import COUPLED, SMALL, SPOT
from simgap.ground.names import names_of
from simgap.types import Recording, Sessions

DRAWN: dict[int, tuple[Machine, ...]] = {0: SMALL, 2000: (SPOT,), 3000: COUPLED}
"""From each number on, the machines of which one is drawn: small ones, the one with legs and an arm, coupled ones."""
USUAL, BRIEF, LONG = (6, 210), (2, 60), (6, 900)
"""Sessions of a case and rows of each, usually, where little and where much was recorded: equal shapes are compiled
once."""
SHARE_BRIEF = 0.15
"""Of the cases."""
FITTED = 2 / 3
"""Of the sessions; the others are held out."""
KINDS = {"nothing": 0.12, "within": 0.25, "two": 0.08, "outside": 0.15, "mixed": 0.1, "many": 0.3}
"""Shares of the cases by what is left out: nothing; a law that has a name, two of them; one that has none; one of
either; and `MANY` of any families, as in real machines."""
MANY = 3, 5
"""Laws of a case that lacks many, from and to."""
STRAIGHT, BENDS = 0.4, (0.9, 4.0)
"""Share of the laws whose strength is even; how much that of the others varies, and its waves per unit, at most."""
EVERYWHERE = 0.5
"""Share of the laws that act along all axes; the others act along one."""
SHAKEN, CALM = (0.01, 1.0), 0.3
"""Random changes of the velocities, as a share of what these usually change by from row to row; share of the cases that
have none."""
NOISE = 0.02, 0.6
"""Scale of a measurement's noise, as a share of what its output usually changes by from row to row."""
WARM = 20
"""Rows before a recording begins."""


class Case(NamedTuple):
    """A case: machine, what it lacks (names of families), sessions, and how much that shows.

    strength: half the squared change of the next row that the laws make, in units of the noise and of what changes the
    velocities at random, and half the squared error of what sensors show, in units of the noise, summed over the fitted
    rows and the outputs [nats]: what a perfect observer would gain who knew state and laws. Of states that are not
    recorded, only what they change in their own row counts.
    """

    number: int
    machine: Machine
    kind: str
    families: tuple[str, ...]
    tails: str
    sessions: Sessions
    strength: float

    @property
    def causes(self) -> list[frozenset[str]]:
        """For each law, the effects that name it rightly."""
        return [names_of(f, self.machine.name) for f in self.families]


def draw(number: int) -> Case:
    """The case of that number."""
    rng = np.random.default_rng([20261128, number])
    machines = DRAWN[max(first for first in DRAWN if first <= number)]
    machine = machines[rng.integers(len(machines))]
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    return recorded(number, machine, kind, _families(kind, machine, rng))


def recorded(number: int, machine: Machine, kind: str, families: tuple[str, ...]) -> Case:
    """A case of a machine that has laws of these families; its number decides all the rest."""
    rng = np.random.default_rng([20261129, number])
    least, most = np.log(machine.sizes)
    sizes = np.exp(rng.uniform(least, most, len(families)))
    params = machine.drawn(rng)
    rate = machine.rate(params)
    drawn = int(rng.integers(2**32))
    count, rows = _shape(machine, rng)
    share = 0.0 if rng.random() < CALM else np.exp(rng.uniform(*np.log(SHAKEN)))
    clean, shaken = [], np.zeros(len(machine.velocities))
    for session in range(count):
        # The same laws in all sessions, but for what is random in time.
        laws = [_law(machine, f, s, rate, np.random.default_rng([drawn, i]))
                for i, (f, s) in enumerate(zip(families, sizes, strict=True))]  # fmt: skip
        for law in laws:
            law.begin(np.random.default_rng([drawn, len(laws), session]))
        command = drawn_commands(len(machine.schema.command), rng, WARM + rows)
        shakes = rng.standard_normal((WARM + rows, len(shaken)))
        if session == 0 and share:
            calm = _simulated(machine, params, [], command, shakes * 0)
            # `take` keeps rows together: a sum in another order is another case.
            shaken = share * np.std(np.diff(np.take(calm.state, machine.velocities, 1), axis=0), 0)
        clean.append(_simulated(machine, params, laws, command, shakes * shaken))
    scale = np.exp(rng.uniform(*np.log(NOISE))) * np.std(np.concatenate([np.diff(c.state, axis=0) for c in clean]), 0)
    tails = str(rng.choice(["gaussian", "student_t", "laplace", "quantised"]))
    recordings = [_measured(f"session_{i:02d}", machine, c, scale, tails, rng) for i, c in enumerate(clean)]
    fitted = int(FITTED * count)
    sessions = Sessions(recordings[:fitted], recordings[fitted:], exchangeable=True)
    strength = _strength(machine, clean[:fitted], scale, np.hypot(scale, machine.of_velocities(shaken)))
    return Case(number, machine, kind, families, tails, sessions, strength)


def _shape(machine: Machine, rng: np.random.Generator) -> tuple[int, int]:
    """Sessions and rows of each."""
    place = rng.random()
    return BRIEF if place < SHARE_BRIEF else LONG if place > 1 - machine.often_long else USUAL


def _strength(
    machine: Machine, clean: Sequence["_Clean"], scale: Float[np.ndarray, " s"], random: Float[np.ndarray, " s"]
) -> float:
    """How much laws show. scale: of the noise; random: of this and of what changes the velocities at random."""
    observed = np.array([f.observed for f in machine.schema.state])
    changed = np.concatenate([c.changed for c in clean]) / random
    misread = np.concatenate([c.shown - c.state for c in clean]) / scale
    return float(0.5 * (changed[:, observed] ** 2).sum() + 0.5 * (misread[:, observed] ** 2).sum())


def _families(kind: str, machine: Machine, rng: np.random.Generator) -> tuple[str, ...]:
    possible = [name for name, family in FAMILIES.items() if machine.name in family.machines]
    within = [f for f in possible if names_of(f, machine.name)]
    outside = [f for f in possible if f not in within]
    if kind == "nothing":
        return ()
    if kind == "two":
        return tuple(map(str, rng.choice(within, 2, replace=False)))
    if kind == "mixed":
        return (str(rng.choice(within)), str(rng.choice(outside)))
    if kind == "many":
        return tuple(map(str, rng.choice(possible, rng.integers(MANY[0], MANY[1] + 1), replace=False)))
    return (str(rng.choice(within if kind == "within" else outside)),)


def _law(machine: Machine, family: str, size: float, rate: float, rng: np.random.Generator) -> Law:
    """A law of the family, along some axes of the machine and with a strength that may vary."""
    law = FAMILIES[family].draw(rng, size, machine.time_step, rate)
    count = len(machine.velocities)
    possible = machine.driven if law.of_commands else range(count)
    axes = np.isin(np.arange(count), possible).astype(float)
    if rng.random() > EVERYWHERE:
        axes = np.eye(count)[rng.choice(possible)]
    if given := FAMILIES[family].axes:
        axes = np.isin(np.arange(count), given).astype(float)
    depth = 0.0 if rng.random() < STRAIGHT else rng.uniform(0, BENDS[0])
    return Uneven(law, axes, depth, rng.uniform(0.5, BENDS[1]), rng.uniform(0, 2 * np.pi))


class _Clean(NamedTuple):
    """Noise-free states, what sensors show of them, the commands, and what the laws changed in each row."""

    state: Float[np.ndarray, "T s"]
    shown: Float[np.ndarray, "T s"]
    command: Float[np.ndarray, "T u"]
    changed: Float[np.ndarray, "T s"]


def _simulated(
    machine: Machine,
    params: Float[np.ndarray, " p"],
    laws: Sequence[Law],
    command: Float[np.ndarray, "T u"],
    shakes: Float[np.ndarray, "T v"],
) -> _Clean:
    """A session of the machine from rest, without the rows before its recording begins. shakes: of the velocities."""
    state = machine.start
    states, readings, commands, changes = [], [], [], []
    for drawn, shake in zip(command, shakes, strict=True):
        sent = machine.sent(drawn, state)
        states.append(state)
        commands.append(sent)
        readings.append(machine.shown(state, laws))
        after = machine.row(params, state, sent, laws)
        changes.append(after - machine.row(params, state, sent, ()))
        state = after + machine.of_velocities(shake)
    kept = slice(WARM, None)
    return _Clean(np.array(states)[kept], np.array(readings)[kept], np.array(commands)[kept], np.array(changes)[kept])


def _measured(
    name: str,
    machine: Machine,
    clean: _Clean,
    scale: Float[np.ndarray, " s"],
    tails: str,
    rng: np.random.Generator,
) -> Recording:
    shape = clean.shown.shape
    if tails == "quantised":
        step = 2 * np.where(scale > 0, scale, 1.0)
        state = step * np.round((clean.shown + 0.3 * scale * rng.standard_normal(shape)) / step)
    else:
        drawn = {"gaussian": rng.standard_normal, "student_t": lambda s: rng.standard_t(4, s) / np.sqrt(2),
                 "laplace": lambda s: rng.laplace(0, np.sqrt(0.5), s)}[tails](shape)  # fmt: skip
        state = clean.shown + scale * drawn
    observed = [f.observed for f in machine.schema.state]
    return Recording(name, machine.time_step * np.arange(shape[0]), state[:, observed], clean.command)
