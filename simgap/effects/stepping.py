"""The next state of a simulator: a JAX function, or an engine, either tabulated or called directly.

Only here do they differ: pushes enter the commands and velocities of a function, but are forces on an engine.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.effects.augmented import Active, Augmented, Theta
from simgap.effects.effect import Step
from simgap.engines import Engine, Table, is_engine
from simgap.kinematics import carried_velocity, motion, push, substituted
from simgap.layout import Layout


def parts_of(augmented: Augmented) -> int | None:
    """Parts of a row in which commands may differ; None where a row has one command."""
    return augmented.simulator.parts if is_engine(augmented.simulator) else None


def terms_of(augmented: Augmented, theta: Theta, active: Active = None) -> Float[Array, " k"] | None:
    """Values of an engine's terms; None where the simulator is no engine."""
    if not is_engine(augmented.simulator):
        return None
    nil = jnp.zeros(len(augmented.simulator.terms))
    return sum((law(nil) for law in augmented.laws(theta, active, "engine")), nil)


class Given(NamedTuple):
    """What a step depends on apart from the state: parameters and the command that acts (for an engine, in the parts of
    the row); for an engine also its table for this row, where it is tabulated, and the values of its terms."""

    phi: Float[Array, " p"]
    command: Float[Array, "... u"]
    table: Table | None
    terms: Float[Array, " k"] | None


def next_state(augmented: Augmented, state: Float[Array, " s"], given: Given) -> Float[Array, " s"]:
    """The next state without pushes."""
    if not is_engine(augmented.simulator):
        return augmented.simulator.step(given.phi, state, given.command)
    return _engine(augmented.simulator, state, given, jnp.zeros(len(efforts(augmented.layout))))


def pushed_state(
    augmented: Augmented,
    state: Float[Array, " s"],
    given: Given,
    heading: Float[Array, " b"],
    delta: Float[Array, "b 4"],
) -> tuple[Float[Array, " s"], Float[Array, " s"]]:
    """The next state with a push on each body, in its own frame, and its part that is a position rate [1/s].

    Half of what a push adds to velocities acts before the step and half after it [Strang 1968]: a body that is pushed
    all along gains half of the row's velocity in the row's positions.
    """
    if is_engine(augmented.simulator):
        where = efforts(augmented.layout)
        effort = jnp.stack([delta[b, a] for b, a in where]) if where else jnp.zeros(0)
        then = _engine(augmented.simulator, state, given, effort)
        return then, jnp.zeros_like(then)
    du, dv, dp = push(augmented.layout, heading, delta)
    return augmented.simulator.step(given.phi, state + dv / 2, given.command + du) + dv / 2, dp


def ending(
    augmented: Augmented,
    state: Float[Array, " s"],
    given: Given,
    step: Step,
    size: Float[Array, "b 1"],
) -> Float[Array, "b 4"]:
    """The push on each body, by axis, that ends its motion within the step.

    The motion is that which the body's own drive causes, not what carriers add. Otherwise, where a simulator's velocity
    memory includes the carrier's motion, an arm at rest on a walking base would slide in its joints. size: of a usual
    push; in some units a push of one would be lost in the rounding of the velocity.
    """
    layout, (_, then) = step.layout, step.states
    moved, _ = pushed_state(augmented, state, given, step.now.heading, size * jnp.ones_like(step.now.velocity))
    # Frames are held fixed: a push that turns a body must not count along its other axes.
    for heading in {h for h in layout.heading if h is not None}:
        moved = substituted(moved, heading, then[heading])
    response = (motion(layout, moved).velocity - step.then.velocity) / size
    alone = next_state(augmented, state - carried_velocity(layout, state, state), given)
    return -motion(layout, alone).velocity / jnp.where(response != 0, response, jnp.inf)


def efforts(layout: Layout) -> list[tuple[int, int]]:
    """Body and axis of every velocity that an engine can push, in the order of the states."""
    fields = layout.schema.state
    places = (np.argwhere(layout.velocity == i)[0] for i, f in enumerate(fields) if f.effort)
    return [(int(b), int(a)) for b, a in places]


def _engine(engine: Engine, state: Float[Array, " s"], given: Given, effort: Float[Array, " a"]) -> Float[Array, " s"]:
    phi, command, table, terms = given
    assert terms is not None  # an engine always has terms, if only an empty array
    if table is not None:
        return (
            jnp.asarray(table.then)
            + (state - table.state) @ table.by_state
            + (command - table.command).ravel() @ table.by_command
            + phi @ table.by_phi
            + effort @ table.by_effort
            + terms @ table.by_term
            + terms**2 @ table.by_term_squared
        )
    shape = jax.ShapeDtypeStruct(state.shape, state.dtype)
    return jax.pure_callback(
        partial(_rows, engine), shape, phi, terms, state, command, effort, vmap_method="expand_dims"
    )


def _rows(engine: Engine, *given: np.ndarray) -> np.ndarray:
    """The engine's rows. What is the same for all rows is given once, along an axis of length one."""
    phi, *batched = (np.asarray(a, np.float64) for a in given)
    if batched[1].ndim == 1:
        return engine.rows(phi, *(a[None] for a in batched))[0].astype(np.float32)
    count = max(len(a) for a in batched)
    rows = [np.broadcast_to(a, (count, *a.shape[1:])) for a in batched]
    # Batches are filled up by repetition: equal rows are stepped once.
    flat = np.hstack([a.reshape(count, -1) for a in rows])
    first, back = np.unique(flat, axis=0, return_index=True, return_inverse=True)[1:]
    then = engine.rows(phi[(0,) * (phi.ndim - 1)], *(a[first] for a in rows))
    return then[back.ravel()].astype(np.float32)
