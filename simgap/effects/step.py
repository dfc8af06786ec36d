"""One step of the augmented simulator: command path, memory, motion, and sensors."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.augmented import Active, Augmented, Law, Theta, where
from simgap.effects.command_filters import NEVER, fading_of
from simgap.effects.dry_friction import opposed
from simgap.effects.effect import HISTORY_ROWS, SENSED_ROWS, Earlier, Memory, Row, Scales, Step
from simgap.effects.sensing import padded
from simgap.effects.sites import usual_push
from simgap.effects.stepping import Given, ending, next_state, parts_of, pushed_state, terms_of
from simgap.engines import is_engine
from simgap.kinematics import motion, wrapped

_Bends = dict[str, Float[Array, "b 4"]]
"""The memory of every law of hysteresis, by key."""


def fading(augmented: Augmented, phi: Float[Array, " p"], theta: Theta, active: Active = None) -> Float[Array, " u"]:
    """How fast the early part of a row is forgotten, per command; `NEVER` where no law on their way asks for it."""
    if augmented.laws(theta, active, "command", "filter") and not is_engine(augmented.simulator):
        return fading_of(augmented.simulator, augmented.layout, phi)
    return jnp.full(len(augmented.layout.schema.command), NEVER)


def remember(
    augmented: Augmented,
    forgets: Float[Array, " u"],
    theta: Theta,
    state: Float[Array, " s"],
    earlier: Earlier,
    time_s: Float[Array, ""],
    active: Active = None,
) -> Memory:
    """Memory at a start, from more than HISTORY_ROWS earlier commands; sensors are taken to have seen `state` alone.
    forgets: `fading`.

    Play and lags remember long, so the command path first runs over all earlier commands, for filters that outlast a
    rest over what each turned at before these as well. Hysteresis runs over the earlier states.
    """
    past, turns, _ = earlier
    filters = augmented.laws(theta, active, "filter")
    sent = past[::-1]
    first = sent[HISTORY_ROWS - 1 :: -1]
    bent, states = remember_motion(augmented, theta, state, earlier, active)
    row = Row(time_s, jnp.ones(()))

    def run(memory: Memory, commands: Float[Array, "n u"]) -> Memory:
        return jax.lax.scan(lambda m, u: (follow(augmented, theta, m, u, row, active)[0], None), memory, commands)[0]

    def held(memory: Memory, turned: Float[Array, "m u"]) -> Memory:
        # Each value is taken to have been held, so that dead time does not matter.
        still = lambda m, u: m._replace(commands=jnp.tile(u, (HISTORY_ROWS, 1)))  # noqa: E731
        step = lambda m, u: (follow(augmented, theta, still(m, u), u, row, active)[0], None)  # noqa: E731
        return jax.lax.scan(step, memory, turned)[0]

    def rested(u: Float[Array, " u"]) -> dict[str, Float[Array, "... u"]]:
        return {law.effect.key: law.effect.rest(u) for law in filters}

    def settled() -> dict[str, Float[Array, "... u"]]:
        memory = Memory(first, rested(first[0]), bent, states, forgets)
        if turns is not None:
            began = memory._replace(filters=rested(turns[-1]))
            outlasted = held(began, turns[::-1]).filters
            lasting = {law.effect.key: outlasted[law.effect.key] for law in filters if law.effect.lasts}
            memory = memory._replace(filters={**memory.filters, **lasting})
        return run(memory, sent[HISTORY_ROWS:]).filters

    filter_states = _if_any(filters, settled, rested(past[0]))
    return Memory(past[:HISTORY_ROWS], filter_states, bent, states, forgets)


def remember_motion(
    augmented: Augmented, theta: Theta, state: Float[Array, " s"], earlier: Earlier, active: Active = None
) -> tuple[_Bends, Float[Array, "r s"]]:
    """The memory of motion at a start: `Memory.bent` and `Memory.states`."""
    bent = _bent(augmented, augmented.laws(theta, active, "hysteresis"), state, earlier.states)
    return bent, jnp.tile(state, (SENSED_ROWS, 1))


def _bent(
    augmented: Augmented, laws: Sequence[Law], state: Float[Array, " s"], earlier: Float[Array, "w s"] | None
) -> _Bends:
    """Memories of laws of hysteresis after the ways between the earlier states and to `state`."""
    unbent = {law.effect.key: jnp.zeros((len(augmented.layout.bodies), 4)) for law in laws}
    if earlier is None:
        return unbent
    ways = wrapped(augmented.layout, jnp.diff(jnp.concatenate([earlier[::-1], state[None]]), axis=0))
    step = lambda bent, way: (_bend(augmented, laws, bent, way)[0], None)  # noqa: E731
    return _if_any(laws, lambda: jax.lax.scan(step, unbent, ways)[0], unbent)


def _bend(
    augmented: Augmented, laws: Sequence[Law], bent: _Bends, way: Float[Array, " s"]
) -> tuple[_Bends, Float[Array, "b 4"]]:
    """Memories of laws of hysteresis at the end of a way, and their push on it."""
    found = {law.effect.key: law.effect.law(law.c, bent[law.effect.key], way, augmented.layout) for law in laws}
    still = jnp.zeros((len(augmented.layout.bodies), 4))
    return {key: z for key, (z, _) in found.items()}, sum((push for _, push in found.values()), still)


def _if_any(laws: Sequence[Law], value: Callable[[], Any], nil: Any) -> Any:
    """`value()` if one of the laws acts, else `nil` of the same shapes."""
    switches = [law.on for law in laws if law.on is not None]
    if not laws:
        return nil
    return where(jnp.stack(switches).any() if switches else None, value, nil)


def follow(
    augmented: Augmented,
    theta: Theta,
    memory: Memory,
    command: Float[Array, " u"],
    row: Row,
    active: Active = None,
) -> tuple[Memory, Float[Array, "... u"]]:
    """The memory with the sent command in it, and the command that acts: places "command" and "filter".

    Laws act in the order of the catalogue: dead time first, then the actuators' response, their limits last. For an
    engine, returns the commands that act in the parts of the row.
    """
    parts, filters = parts_of(augmented), dict(memory.filters)
    u = command if parts is None else jnp.tile(command, (parts, 1))
    for law in augmented.laws(theta, active, "command", "filter"):
        if law.effect.place == "command":
            u = law(u, u, memory, row, augmented.layout)
        else:
            filters[law.effect.key], u = _filtered(law, u, filters[law.effect.key], memory.fading)
    commands = jnp.concatenate([command[None], memory.commands[:-1]])
    return memory._replace(commands=commands, filters=filters), u


def _filtered(
    law: Law, u: Float[Array, "... u"], z: Float[Array, "... u"], fading: Float[Array, " u"]
) -> tuple[Float[Array, "... u"], Float[Array, "... u"]]:
    """A filter's new memory and the command that acts; part by part where a row has several."""
    if u.ndim == 1:
        return law((law.effect.rest(u), u), u, z, fading, 1.0)

    def part(z: Float[Array, "... u"], sent: Float[Array, " u"]) -> tuple[Float[Array, "... u"], Float[Array, " u"]]:
        return law((z, sent), sent, z, fading, 1 / len(u))

    return jax.lax.scan(part, z, u)


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
    """The next state and memory: the command path (`follow`), then the motion (`move`)."""
    memory, u = follow(augmented, theta, memory, command, row, active)
    return move(augmented, phi, theta, scales, memory, state, u, row, active)


def move(
    augmented: Augmented,
    phi: Float[Array, " p"],
    theta: Theta,
    scales: Scales,
    memory: Memory,
    state: Float[Array, " s"],
    u: Float[Array, "... u"],
    row: Row,
    active: Active = None,
) -> tuple[Memory, Float[Array, " s"]]:
    """The next state, and the memory of motion, with the command u that acts.

    In order: which velocity is remembered ("before"); the simulator's own step, with the terms of an engine ("engine");
    the pushes, from the motion before and after that step ("push", "friction", "hysteresis"), and the step again with
    them; how positions advance and what stops them ("after").
    """
    layout, start = augmented.layout, state
    for law in augmented.laws(theta, active, "before"):
        start = law(start, start, layout, scales)

    given = Given(phi, u, row.table, terms_of(augmented, theta, active))
    then = next_state(augmented, start, given)
    laws, dry, lasting = (augmented.laws(theta, active, place) for place in ("push", "friction", "hysteresis"))

    def pushed() -> tuple[_Bends, Float[Array, " s"]]:
        now, expected = motion(layout, state), motion(layout, then)
        nil = jnp.zeros_like(now.velocity)
        sent = u if u.ndim == 1 else u.mean(0)
        step = Step(now, expected, (state, then), sent, layout, scales, row)

        def friction() -> Float[Array, "b 4"]:
            limits = [law.effect.law(law.c, step) for law in dry]
            return opposed(ending(augmented, start, given, step, usual_push(layout, scales)), sum(limits, nil))

        def bend(end: Float[Array, " s"]) -> tuple[_Bends, Float[Array, "b 4"]]:
            return _bend(augmented, lasting, memory.bent, wrapped(layout, end - state))

        push = sum((law(nil, step) for law in laws), nil)
        push = push + _if_any(dry, friction, nil) + _if_any(lasting, lambda: bend(then)[1], nil)
        moved, rates = pushed_state(augmented, start, given, now.heading, push)
        end = moved + augmented.simulator.time_step * rates
        # By the predicted way: that between corrected states would be longer by their noise.
        return _if_any(lasting, lambda: bend(end)[0], memory.bent), end

    bent, then = _if_any([*laws, *dry, *lasting], pushed, (memory.bent, then))
    memory = memory._replace(bent=bent)
    for law in augmented.laws(theta, active, "after"):
        then = law(then, state, then, layout, scales, row)
    return memory._replace(states=jnp.concatenate([state[None], memory.states[:-1]])), then


def sense(
    augmented: Augmented, theta: Theta, memory: Memory, state: Float[Array, " s"], row: Row, active: Active = None
) -> Float[Array, " s"]:
    """What is measured of a state, given the states before it; `row` is that of the state."""
    return sensed(augmented, theta, memory, state, row, active)[0]


def sensed(
    augmented: Augmented, theta: Theta, memory: Memory, state: Float[Array, " s"], row: Row, active: Active = None
) -> tuple[Float[Array, " s"], Float[Array, " s"]]:
    """The same, and its slope by the state: minus one where a sensor shows a negative value as a positive one."""
    slope = jnp.ones_like(state)
    for law in augmented.laws(theta, active, "sensing"):
        if (of := law.effect.slope) is not None:
            slope = slope * where(law.on, lambda of=of, law=law, at=state: of(law.c, at), jnp.ones_like(state))
        state = law(state, state, memory.states, row, augmented.layout)
    return state, slope


def unsense(
    augmented: Augmented, theta: Theta, measured: Float[Array, " s"], time_s: Float[Array, ""]
) -> Float[Array, " s"]:
    """The state at rest that gives a measurement: inverts bias, its drift, and scale. Of two such states, that with
    the sign of the measurement."""
    found = {law.effect.key: law.c[0] for law in augmented.laws(theta, None, "sensing")}

    def of(key: str) -> Float[Array, " s"] | float:
        return padded(found[key], measured) if key in found else 0.0

    bias = of("sensor_bias") + of("sensor_bias.drift") * time_s / 60
    return (measured - bias) / (1 + of("sensor_scale"))
