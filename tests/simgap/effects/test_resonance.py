"""The resonance against fine steps of its differential equation."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from joint import JOINT, freely, recorded
from stated import check_named_alone, stated

from simgap.effects.command_filters import NEVER, resonance, resting
from simgap.types import Recording

FINE = 600
PERIOD, DAMPING = 0.3, 0.2


def ringing(rng: np.random.Generator) -> Recording:
    """A joint whose torque swings about the commanded one."""
    acting, rate, w = 0.0, 0.0, 2 * np.pi / PERIOD

    def follows(q: float, speed: float, torque: float, h: float) -> tuple[float, float]:
        nonlocal acting, rate
        rate += h * (w**2 * (torque - acting) - 2 * DAMPING * w * rate)
        acting += h * rate
        return freely(q, speed, acting, h)

    return recorded(rng, follows)


def test_a_torque_that_swings_is_named_with_its_period() -> None:
    check_named_alone(stated(JOINT, ringing, 0), "resonance", {"period": PERIOD, "damping": DAMPING})


def integrated(rows: float, damping: float, commands: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Where x'' = w^2 (u - x) - 2 d w x' is at the end of every row, and its mean over the row."""
    w, h, x, v = 1 / rows, 1 / FINE, commands[0], 0.0
    ends, means = [], []
    for u in commands:
        mean = 0.0
        for _ in range(FINE):
            halfway, faster = x + h / 2 * v, v + h / 2 * (w**2 * (u - x) - 2 * damping * w * v)
            x, v = x + h * faster, v + h * (w**2 * (u - halfway) - 2 * damping * w * faster)
            mean += halfway * h
        ends.append(x)
        means.append(mean)
    return np.array(ends), np.array(means)


def passed(rows: float, damping: float, commands: list[float], parts: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """The same by the law, with every row in parts."""
    c, z = jnp.array([[rows], [damping]]), resting(jnp.array(commands[:1]))
    ends, means = [], []
    for u in commands:
        acting = []
        for _ in range(parts):
            z, acts = resonance(c, jnp.array([u]), z, jnp.array([NEVER]), 1 / parts)
            acting.append(acts[0])
        ends.append(u + float(z[0, 0] - u) + damping / np.sqrt(1 - damping**2) * float(z[1, 0]))
        means.append(float(np.mean(acting)))
    return np.array(ends), np.array(means)


@given(
    st.floats(0.4, 20.0), st.floats(0.02, 0.6), st.lists(st.floats(-2, 2), min_size=2, max_size=6), st.integers(1, 3)
)
def test_it_is_the_second_order_response_to_commands_that_are_held(
    rows: float, damping: float, commands: list[float], parts: int
) -> None:
    for true, found in zip(integrated(rows, damping, commands), passed(rows, damping, commands, parts), strict=True):
        np.testing.assert_allclose(found, true, atol=2e-4)


@given(st.floats(-2, 2), st.floats(-2, 2))
def test_without_a_period_commands_pass(u: float, before: float) -> None:
    z, acts = resonance(jnp.zeros((2, 1)), jnp.array([u]), resting(jnp.array([before])), jnp.array([0.3]), 1.0)
    assert float(acts[0]) == pytest.approx(u)
    np.testing.assert_array_equal(z, resting(jnp.array([u])))


def test_a_row_that_is_partly_forgotten_counts_its_end_more() -> None:
    """Then the command acts that leads to the same velocity: nearer to where the swing ends than to its mean."""
    c, z = jnp.array([[2.0], [0.3]]), resting(jnp.zeros(1))
    acts = [float(resonance(c, jnp.ones(1), z, jnp.array([f]), 1.0)[1][0]) for f in (NEVER, 1.0, 3.0)]
    assert acts[0] < acts[1] < acts[2] < integrated(2.0, 0.3, [0.0, 1.0])[0][1]
