"""The delay of an engine's command, which changes within a part of a row."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from simgap.effects.command_path import EFFECTS
from simgap.effects.effect import HISTORY_ROWS, Memory

PARTS, ROWS = 5, 12
DELAY = next(e for e in EFFECTS if e.key == "delay")


def acting(commands: np.ndarray, delay: float) -> np.ndarray:
    """Commands that act in the parts of all rows, of one command that was held at its first value before."""
    held = np.r_[np.full(HISTORY_ROWS, commands[0]), commands]
    rows = []
    for row in range(ROWS):
        history = held[row : row + HISTORY_ROWS][::-1]
        memory = Memory(jnp.asarray(history[:, None]), {}, {}, jnp.zeros((0, 1)), jnp.zeros(1))
        sent = jnp.full((PARTS, 1), commands[row])
        rows.append(DELAY.law(jnp.array([[delay]]), sent, memory, None, None)[:, 0])
    return np.concatenate(rows)


@given(
    delay=st.floats(0.0, float(HISTORY_ROWS), allow_subnormal=False),
    commands=st.lists(st.floats(-1.0, 1.0, width=32), min_size=ROWS, max_size=ROWS),
)
def test_a_free_mass_ends_where_the_delayed_force_leads_it(delay: float, commands: list[float]) -> None:
    """Its velocity and its position at the end of a part in which nothing changed, with unit mass and rows of 1."""
    forces = np.array(commands)
    step = 1 / PARTS
    velocity, position = 0.0, 0.0
    for force in acting(forces, delay):
        position += velocity * step + force * step**2 / 2
        velocity += force * step
    changes = np.diff(forces, prepend=forces[0])
    left = np.maximum(ROWS - np.arange(ROWS) - delay, 0.0)  # time for which a change of the force has acted
    # What changes in the last part of all is given the rest of its effect in the part after.
    settled = (left == 0) | (left >= step)
    expected = forces[0] * ROWS + changes @ left
    np.testing.assert_allclose(velocity, expected, atol=(1e-4 if settled.all() else 0.3 * step))
    if settled.all():
        np.testing.assert_allclose(position, forces[0] * ROWS**2 / 2 + changes @ left**2 / 2, atol=1e-3)


def test_nothing_is_delayed_by_nothing() -> None:
    commands = np.random.default_rng(0).normal(size=ROWS)
    np.testing.assert_array_equal(acting(commands, 0.0), np.repeat(commands.astype(np.float32), PARTS))
