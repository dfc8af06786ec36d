"""The reward at points computed by hand, and its laws."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simgap.policies.reward import Config, long_tailed_sigmoid, r_action, r_ee_base, r_state, reward
from simgap.simulators.spot import rotation

PAPER = Config(state_bound=0.15, state_margin=1.5, state_value=0.1, arm_length=1.3, arm_margin=1.3, arm_value=0.1,
               base_cost=2.0, ee_cost=0.5, state_weight=1.5, arm_weight=0.01, action_weight=0.1)  # fmt: skip
metres = st.floats(-3.0, 3.0, width=32)


def state(base: tuple[float, float, float], hand: tuple[float, float, float]) -> jnp.ndarray:
    return jnp.concatenate([jnp.array(base), jnp.zeros(3), jnp.array(hand), jnp.zeros(3)])


def test_sigmoid_is_1_at_0_and_its_value_at_the_margin() -> None:
    assert float(long_tailed_sigmoid(jnp.float32(0.0), 1.5, 0.1)) == 1.0
    assert float(long_tailed_sigmoid(jnp.float32(1.5), 1.5, 0.1)) == pytest.approx(0.1)
    # x/m sqrt(1/a - 1) = 0.5 * 3: 1 / (2.25 + 1)
    assert float(long_tailed_sigmoid(jnp.float32(0.75), 1.5, 0.1)) == pytest.approx(1 / 3.25)


@pytest.mark.parametrize(
    ("distance", "expected"),
    [(0.0, 1.0), (0.15, 1.0), (0.65, 1 / (1 + 1.0**2)), (1.15, 1 / (1 + 2.0**2)), (1.65, 0.1)],
)
def test_r_state_by_hand(distance: float, expected: float) -> None:
    """3 / 1.5 m = 2 a metre: half a metre beyond the bound is 1."""
    goal = jnp.array([0.0, 0.6 * distance, 0.5 + 0.8 * distance])
    assert float(r_state(jnp.array([0.0, 0.0, 0.5]), goal, PAPER)) == pytest.approx(expected, rel=1e-5)


def test_r_ee_base_by_hand() -> None:
    """The base's point lies on the floor, and its yaw is no coordinate."""
    base = jnp.array([1.0, 1.0, 2.5])
    assert float(r_ee_base(jnp.array([1.5, 1.0, 1.2]), base, PAPER)) == 1.0  # 0.5 ahead, 1.2 up: 1.3 m
    # 1.95 m away, half a margin beyond the arm: 1 / (1 + 1.5^2)
    assert float(r_ee_base(jnp.array([1.0, 1.75, 1.8]), base, PAPER)) == pytest.approx(1 / 3.25, rel=1e-5)


def test_r_action_and_the_sum_by_hand() -> None:
    command = jnp.array([0.5, 0.0, 1.0, 0.2, 0.4, 0.0])
    assert float(r_action(command, PAPER)) == pytest.approx(-(2.0 * 1.25 + 0.5 * 0.2))
    total = reward(state((0.0, 0.0, 1.0), (0.5, 0.0, 0.5)), jnp.array([0.5, 0.65, 0.5]), command, PAPER)
    assert float(total) == pytest.approx(1.5 * 0.5 + 0.01 - 0.1 * 2.6, rel=1e-5)


@settings(max_examples=25, deadline=None)
@given(metres, metres, metres, metres, st.floats(-3.0, 3.0, width=32))
def test_the_reward_knows_no_world_frame(x: float, y: float, shift: float, goal_x: float, yaw: float) -> None:
    R, command = rotation(jnp.float32(yaw)), jnp.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    hand, goal, offset = jnp.array([x, y, 0.5]), jnp.array([goal_x, 0.0, 0.7]), jnp.array([shift, -shift, 0.0])
    here = reward(state((0.0, 0.0, 0.0), tuple(hand)), goal, command, PAPER)
    there = reward(state((shift, -shift, yaw), tuple(R @ hand + offset)), R @ goal + offset, command, PAPER)
    np.testing.assert_allclose(here, there, rtol=1e-4, atol=1e-5)
    assert -1.3 < float(here) <= 1.51
