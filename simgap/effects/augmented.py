"""A simulator with all effects of the catalogue at all their sites; with all constants zero it is the simulator.

Laws whose constants are zero are nil, and yet take their time. `active` says which effects act at all, so that the
others cost nothing. It must be the same for all that is computed side by side, for under `vmap` a condition that
differs computes both branches.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from simgap.effects import CATALOGUE
from simgap.effects.command_path import NEVER, fading_of
from simgap.effects.effect import HISTORY_ROWS, SENSED_ROWS, Effect, Memory, Row, Scales, Site, Step, usual_push
from simgap.layout import Layout, Motion, carried_velocity, motion, push, substituted
from simgap.types import StepModel

Theta = Float[Array | np.ndarray, " P"]
"""Internal constants of all effects at all sites; numpy's where they are known before any tracing."""
Active = Bool[Array, " effects"] | None
"""Which effects of the catalogue act; None: all do."""


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

    @cached_property
    def ranges(self) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Least and greatest values of the parameters in 32 bits: none lies outside the range that is declared."""
        low, high = np.array([(p.low, p.high) for p in self.simulator.parameters], float).reshape(-1, 2).T
        least, most = low.astype(np.float32), high.astype(np.float32)
        least = np.where(least < low, np.nextafter(least, np.float32(np.inf)), least)
        most = np.where(most > high, np.nextafter(most, np.float32(-np.inf)), most)
        return least, np.maximum(least, most)

    @cached_property
    def nominal(self) -> Float[np.ndarray, " p"]:
        """The parameters that the simulator is used with as it is."""
        values = [(p.low + p.high) / 2 if p.nominal is None else p.nominal for p in self.simulator.parameters]
        return np.clip(np.array(values, np.float32), *self.ranges)

    @cached_property
    def effect_of(self) -> np.ndarray:
        """Index in the catalogue of the effect that each entry of theta belongs to."""
        return np.array([slot.effect for slot in self.slots], int)

    def active(self, *thetas: Float[Array | np.ndarray, " P"]) -> Bool[Array, " effects"]:
        """The effects that have a constant other than zero in any of these."""
        on = jnp.any(jnp.stack([jnp.asarray(theta) for theta in thetas]) != 0, axis=0)
        return jnp.zeros(len(CATALOGUE), bool).at[self.effect_of].max(on)

    def laws(self, theta: Theta, active: Active, *places: str) -> list["Law"]:
        """The effects of some places that have sites.

        Where theta is numpy's, effects whose constants are all zero are left out: they are nil.
        """
        found, start, known = [], 0, isinstance(theta, np.ndarray)
        for i, (effect, sites) in enumerate(zip(CATALOGUE, self.sites, strict=True)):
            size = len(effect.constants) * len(sites)
            c = theta[start : start + size].reshape(len(effect.constants), len(sites))
            if sites and effect.place in places and not (known and not c.any()):
                found.append(Law(effect, jnp.asarray(c), None if active is None else active[i]))
            start += size
        return found


class Law(NamedTuple):
    """An effect with its constants; `on`: whether it acts, None for yes."""

    effect: Effect
    c: Float[Array, "k sites"]
    on: Bool[Array, ""] | None

    def __call__(self, nil: Any, *args: Any) -> Any:
        """What the law makes of its arguments, `nil` where it does not act."""
        return where(self.on, lambda: self.effect.law(self.c, *args), nil)


def where(on: Bool[Array, ""] | None, value: Callable[[], Any], nil: Any) -> Any:
    """The value where it is on, computed only there; `nil`, of the same shapes, elsewhere."""
    return value() if on is None else jax.lax.cond(on, value, lambda: nil)


def remember(
    augmented: Augmented,
    phi: Float[Array, " p"],
    theta: Theta,
    state: Float[Array, " s"],
    past: Float[Array, "n u"],
    time_s: Float[Array, ""],
    turns: Float[Array, "m u"] | None = None,
    active: Active = None,
) -> Memory:
    """Memory at a start: `past[k]` was sent k + 1 rows ago, n > HISTORY_ROWS; the state has been what it is.

    Play and lags remember long: the command path runs over all past commands first. `turns`: where each command turned
    before that, the latest first, for filters that outlast a rest; without it none did.
    """
    filters = augmented.laws(theta, active, "filter")
    sent = past[::-1]
    first = sent[HISTORY_ROWS - 1 :: -1]
    states = jnp.tile(state, (SENSED_ROWS, 1))
    row = Row(time_s, jnp.ones(()))
    on_the_way = augmented.laws(theta, active, "command", "filter")
    forgets = fading_of(augmented.simulator, augmented.layout, phi) if on_the_way else jnp.full_like(past[0], NEVER)

    def run(memory: Memory, commands: Float[Array, "n u"]) -> Memory:
        return jax.lax.scan(lambda m, u: (follow(augmented, theta, m, u, row, active)[0], None), memory, commands)[0]

    def held(memory: Memory, turned: Float[Array, "m u"]) -> Memory:
        # Each is taken to have been held, so that dead time does not matter.
        still = lambda m, u: m._replace(commands=jnp.tile(u, (HISTORY_ROWS, 1)))  # noqa: E731
        step = lambda m, u: (follow(augmented, theta, still(m, u), u, row, active)[0], None)  # noqa: E731
        return jax.lax.scan(step, memory, turned)[0]

    def settled() -> dict[str, Float[Array, " u"]]:
        memory = Memory(first, {law.effect.key: first[0] for law in filters}, states, forgets)
        if turns is not None:
            began = memory._replace(filters=dict.fromkeys(memory.filters, turns[-1]))
            outlasted = held(began, turns[::-1]).filters
            lasting = {law.effect.key: outlasted[law.effect.key] for law in filters if law.effect.lasts}
            memory = memory._replace(filters={**memory.filters, **lasting})
        return run(memory, sent[HISTORY_ROWS:]).filters

    nil = {law.effect.key: past[0] for law in filters}
    return Memory(past[:HISTORY_ROWS], where(_any(filters), settled, nil), states, forgets)


def _any(laws: Sequence[Law]) -> Bool[Array, ""] | None:
    """Whether one of them acts, None for yes."""
    switches = [law.on for law in laws if law.on is not None]
    return jnp.stack(switches).any() if switches else None


def follow(
    augmented: Augmented,
    theta: Theta,
    memory: Memory,
    command: Float[Array, " u"],
    row: Row,
    active: Active = None,
) -> tuple[Memory, Float[Array, " u"]]:
    """The command that acts, and the memory with the command sent in it: places "command" and "filter".

    The catalogue's order: dead time first, then what the actuators make of the command, their limits last.
    """
    u, filters = command, dict(memory.filters)
    for law in augmented.laws(theta, active, "command", "filter"):
        if law.effect.place == "command":
            u = law(u, u, memory, row, augmented.layout)
        else:
            filters[law.effect.key], u = law((u, u), u, filters[law.effect.key], memory.fading)
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
    active: Active = None,
) -> tuple[Memory, Float[Array, " s"]]:
    """The next state and memory.

    Command path (`follow`), then what velocity is remembered ("before"), the simulator's own step, the
    pushes that the motion before and after it causes ("push"), the step again with them, and how positions advance and
    what stops them ("after").
    """
    layout, simulator = augmented.layout, augmented.simulator
    memory, u = follow(augmented, theta, memory, command, row, active)
    start = state
    for law in augmented.laws(theta, active, "before"):
        start = law(start, start, layout, scales)

    then, laws = simulator.step(phi, start, u), augmented.laws(theta, active, "push")

    def pushed() -> Float[Array, " s"]:
        now, expected = motion(layout, state), motion(layout, then)
        nil = jnp.zeros_like(now.velocity)

        def response() -> Float[Array, "b 4"]:
            # Of the usual size: in other units a push of one is nothing beside the velocity's rounding.
            size = usual_push(layout, scales)
            du, dv, _ = push(layout, now.heading, size * jnp.ones_like(nil))
            moved = simulator.step(phi, start, u + du) + dv
            # The frames stay: a push that turns a body is none along its other axes.
            for heading in {h for h in layout.heading if h is not None}:
                moved = substituted(moved, heading, then[heading])
            return (motion(layout, moved).velocity - expected.velocity) / size

        def own() -> Motion:
            return motion(layout, simulator.step(phi, start - carried_velocity(layout, start, start), u))

        step = Step(now, expected, response, own, u, layout, scales, row)
        du, dv, dp = push(layout, now.heading, sum((law(nil, step) for law in laws), nil))
        return simulator.step(phi, start, u + du) + dv + simulator.time_step * dp

    if laws:
        then = where(_any(laws), pushed, then)
    for law in augmented.laws(theta, active, "after"):
        then = law(then, state, then, layout, scales, row)
    return memory._replace(states=jnp.concatenate([state[None], memory.states[:-1]])), then


def sense(
    augmented: Augmented, theta: Theta, memory: Memory, state: Float[Array, " s"], row: Row, active: Active = None
) -> Float[Array, " s"]:
    """What is measured of a state, given the states before it; `row` is its own."""
    for law in augmented.laws(theta, active, "sensing"):
        state = law(state, state, memory.states, row, augmented.layout)
    return state


def unsense(
    augmented: Augmented, theta: Theta, measured: Float[Array, " s"], time_s: Float[Array, ""]
) -> Float[Array, " s"]:
    """The state at rest that gives a measurement: inverse of bias, its drift, and scale."""
    found = {law.effect.key: law.c[0] for law in augmented.laws(theta, None, "sensing")}
    bias = found.get("sensor_bias", 0.0) + found.get("sensor_bias.drift", 0.0) * time_s / 60
    return (measured - bias) / (1 + found.get("sensor_scale", 0.0))
