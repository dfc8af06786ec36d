"""A simulator with all effects of the catalogue at all their sites; with all constants zero it is the simulator."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.effects import CATALOGUE
from simgap.effects.effect import HISTORY_ROWS, SENSED_ROWS, Effect, Memory, Row, Scales, Site, Step
from simgap.layout import Layout, motion, push
from simgap.types import StepModel

Theta = Float[Array | np.ndarray, " P"]
"""Internal constants of all effects at all sites; numpy's where they are known before any tracing."""


class Slot(NamedTuple):
    """One constant of one effect at one site: a place in the vector theta."""

    effect: int  # in CATALOGUE
    constant: int
    site: int


@dataclass(frozen=True)
class Augmented:
    """`simulator` with theta, a vector of the internal constants of all effects at all sites; nil at zero."""

    simulator: StepModel

    @cached_property
    def layout(self) -> Layout:
        return Layout(self.simulator.schema)

    @cached_property
    def sites(self) -> tuple[tuple[Site, ...], ...]:
        """Sites of every effect of the catalogue; none where it does not apply to this simulator."""
        return tuple(effect.sites(self.layout) for effect in CATALOGUE)

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """What each entry of theta is."""
        return tuple(
            Slot(e, k, s)
            for e, effect in enumerate(CATALOGUE)
            for k in range(len(effect.constants))
            for s in range(len(self.sites[e]))
        )

    @cached_property
    def index(self) -> dict[Slot, int]:
        """Where each constant stands in theta."""
        return {slot: i for i, slot in enumerate(self.slots)}

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest internal values of theta."""
        constants = [CATALOGUE[slot.effect].constants[slot.constant] for slot in self.slots]
        return np.array([c.low for c in constants]), np.array([c.high for c in constants])

    def constants(self, theta: Theta, *places: str) -> list[tuple[Effect, Float[Array, "k n"]]]:
        """The effects of some places that have sites, each with its constants [k, sites].

        Where theta is numpy's, effects whose constants are all zero are left out: they are nil.
        """
        found, start, known = [], 0, isinstance(theta, np.ndarray)
        for effect, sites in zip(CATALOGUE, self.sites, strict=True):
            size = len(effect.constants) * len(sites)
            c = theta[start : start + size].reshape(len(effect.constants), len(sites))
            if sites and effect.place in places and not (known and not c.any()):
                found.append((effect, jnp.asarray(c)))
            start += size
        return found


def remember(
    augmented: Augmented,
    theta: Theta,
    state: Float[Array, " s"],
    past: Float[Array, "n u"],
    time_s: Float[Array, ""],
    turns: Float[Array, "m u"] | None = None,
) -> Memory:
    """Memory at a start: `past[k]` was sent k + 1 rows ago, n > HISTORY_ROWS; the state has been what it is.

    Play and lags remember long: the command path runs over all past commands first. `turns`: where each command turned
    before that, the latest first, for filters that outlast a rest; without it none did.
    """
    keys = [effect.key for effect, sites in zip(CATALOGUE, augmented.sites, strict=True) if effect.place == "filter"]
    sent = past[::-1]
    first = sent[HISTORY_ROWS - 1 :: -1]
    memory = Memory(first, dict.fromkeys(keys, first[0]), jnp.tile(state, (SENSED_ROWS, 1)))
    row = Row(time_s, jnp.ones(()))
    if turns is not None:
        # Each is taken to have been held, so that dead time does not matter.
        held = lambda m, u: m._replace(commands=jnp.tile(u, (HISTORY_ROWS, 1)))  # noqa: E731
        turned = memory._replace(filters=dict.fromkeys(keys, turns[-1]))
        turned = jax.lax.scan(lambda m, u: (follow(augmented, theta, held(m, u), u, row)[0], None), turned, turns[::-1])
        lasting = {e.key: turned[0].filters[e.key] for e in CATALOGUE if e.lasts and e.key in keys}
        memory = memory._replace(filters={**memory.filters, **lasting})
    return jax.lax.scan(lambda m, u: (follow(augmented, theta, m, u, row)[0], None), memory, sent[HISTORY_ROWS:])[0]


def follow(
    augmented: Augmented, theta: Theta, memory: Memory, command: Float[Array, " u"], row: Row
) -> tuple[Memory, Float[Array, " u"]]:
    """The command that acts, and the memory with the command sent in it: places "command" and "filter".

    The catalogue's order: dead time first, then what the actuators make of the command, their limits last.
    """
    u, filters = command, dict(memory.filters)
    for effect, c in augmented.constants(theta, "command", "filter"):
        if effect.place == "command":
            u = effect.law(c, u, memory.commands, row, augmented.layout)
        else:
            u = filters[effect.key] = effect.law(c, u, filters[effect.key])
    commands = jnp.concatenate([command[None], memory.commands[:-1]])
    return memory._replace(commands=commands, filters=filters), u


def advance(
    augmented: Augmented,
    phi: Float[Array, " p"],
    theta: Theta,
    scales: Scales,
    memory: Memory,
    state: Float[Array, " s"],
    command: Float[Array, " u"],
    row: Row,
) -> tuple[Memory, Float[Array, " s"]]:
    """The next state and memory.

    Command path (`follow`), then what velocity is remembered ("before"), the simulator's own step, the
    pushes that the motion before and after it causes ("push"), the step again with them, and how positions advance and
    what stops them ("after").
    """
    layout, simulator = augmented.layout, augmented.simulator
    memory, u = follow(augmented, theta, memory, command, row)
    start = state
    for effect, c in augmented.constants(theta, "before"):
        start = effect.law(c, start, layout, scales)

    then, laws = simulator.step(phi, start, u), augmented.constants(theta, "push")
    if laws:
        now, expected = motion(layout, state), motion(layout, then)
        du, dv, _ = push(layout, now.heading, jnp.ones_like(now.velocity))
        response = motion(layout, simulator.step(phi, start, u + du) + dv).velocity - expected.velocity
        step = Step(now, expected, response, u, layout, scales, row)
        total = sum((effect.law(c, step) for effect, c in laws), jnp.zeros_like(now.velocity))
        du, dv, dp = push(layout, now.heading, total)
        then = simulator.step(phi, start, u + du) + dv + simulator.time_step * dp

    for effect, c in augmented.constants(theta, "after"):
        then = effect.law(c, state, then, layout, scales, row)
    return memory._replace(states=jnp.concatenate([state[None], memory.states[:-1]])), then


def sense(augmented: Augmented, theta: Theta, memory: Memory, state: Float[Array, " s"]) -> Float[Array, " s"]:
    """What is measured of a state, given the states before it."""
    for effect, c in augmented.constants(theta, "sensing"):
        state = effect.law(c, state, memory.states, augmented.layout)
    return state


def unsense(augmented: Augmented, theta: Theta, measured: Float[Array, " s"]) -> Float[Array, " s"]:
    """The state at rest that gives a measurement: inverse of bias and scale."""
    found = {effect.id: c[0] for effect, c in augmented.constants(theta, "sensing")}
    return (measured - found.get("sensor_bias", 0.0)) / (1 + found.get("sensor_scale", 0.0))
