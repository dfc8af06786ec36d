"""Laws of the virtual Spot."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Array, Float

from simgap.robots.virtual_spot import VirtualSpotConfig, VirtualSpotState, init, measure, step
from simgap.simulators.spot import rotation

STILL = (0.0, 0.0, 0.0)
EXACT = replace(
    VirtualSpotConfig(),
    base_process_noise=STILL,
    hand_process_noise=STILL,
    base_measurement_noise=STILL + STILL,
    hand_measurement_noise=STILL + STILL,
)
# A base and an arm that follow their commands by lags alone.
BARE = replace(
    EXACT,
    base_delay=0.0,
    arm_delay=0.0,
    arm_base_coupling=0.0,
    arm_yaw_coupling=0.0,
    base_arm_coupling=0.0,
    base_ripple=STILL,
    hand_ripple=STILL,
)
REACTING = replace(BARE, arm_base_coupling=0.1, arm_yaw_coupling=0.35, base_arm_coupling=0.25)
KEY = jax.random.key(0)
ROWS = 60

metres = st.floats(-3.0, 3.0, width=32)
angles = st.floats(-3.0, 3.0, width=32)


@partial(jax.jit, static_argnames="config")
def drive(state: VirtualSpotState, commands: Float[Array, "T 6"], config: VirtualSpotConfig) -> Float[Array, "T+1 12"]:
    """What is measured before and after each command."""

    def row(state: VirtualSpotState, command: Float[Array, " 6"]) -> tuple[VirtualSpotState, Float[Array, " 12"]]:
        state = step(state, command, KEY, config)
        return state, measure(state, KEY, config)

    return jnp.concatenate([measure(state, KEY, config)[None], jax.lax.scan(row, state, commands)[1]])


def held_commands(seed: int) -> Float[Array, "T 6"]:
    """Commands up to 1, each held for ten rows."""
    return jnp.repeat(jax.random.uniform(jax.random.key(seed), (ROWS // 10, 6), minval=-1.0), 10, axis=0)


def hand_in_base_frame(measured: Float[Array, "T 12"]) -> Float[Array, "T 3"]:
    base = measured[:, :3].at[:, 2].set(0.0)
    return jax.vmap(lambda yaw, arm: rotation(yaw).T @ arm)(measured[:, 2], measured[:, 6:9] - base)


@settings(max_examples=10, deadline=None)
@given(x=metres, y=metres, yaw=angles, side=st.floats(-0.5, 0.5, width=32))
def test_nothing_moves_without_commands(x: float, y: float, yaw: float, side: float) -> None:
    start = init(EXACT)._replace(base_pose=jnp.array([x, y, yaw]), hand=jnp.array([0.85, side, 0.6]))
    measured = drive(start, jnp.zeros((ROWS, 6)), EXACT)
    np.testing.assert_array_equal(measured, jnp.broadcast_to(measured[0], measured.shape))


@settings(max_examples=10, deadline=None)
@given(x=metres, y=metres, yaw=angles, seed=st.integers(0, 1000))
def test_motion_does_not_depend_on_where_the_world_frame_lies(x: float, y: float, yaw: float, seed: int) -> None:
    commands = held_commands(seed)
    here = drive(init(EXACT), commands, EXACT)
    there = drive(init(EXACT)._replace(base_pose=jnp.array([x, y, yaw])), commands, EXACT)

    R = rotation(jnp.array(yaw))
    turned = jnp.concatenate([here[:, i : i + 3] @ R.T for i in (0, 3, 6, 9)], axis=1)
    moved = turned + jnp.array([x, y, yaw, 0, 0, 0, x, y, 0, 0, 0, 0])
    difference = (there - moved).at[:, 2].set(jnp.sin(there[:, 2] - moved[:, 2]))
    np.testing.assert_allclose(difference, 0.0, atol=1e-4)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_command_on_the_base_acts_after_its_delay(axis: int) -> None:
    velocity = drive(init(EXACT), jnp.zeros((ROWS, 6)).at[:, axis].set(1.0), EXACT)[:, 3 + axis]
    # 0.13 s end half a sub-step before row 2 does.
    np.testing.assert_array_equal(velocity[:2], 0.0)
    assert 0.0 < velocity[2] < 0.05
    assert velocity[4] > 0.3


@pytest.mark.parametrize(("delay", "part"), [("base_delay", slice(0, 3)), ("arm_delay", slice(3, 6))])
def test_a_row_more_of_delay_is_the_same_motion_a_row_later(delay: str, part: slice) -> None:
    commands = jnp.zeros((ROWS, 6)).at[:, part].set(held_commands(1)[:, part])
    delayed = replace(EXACT, **{delay: getattr(EXACT, delay) + EXACT.time_step})
    later, sooner = (drive(init(config), commands, config) for config in (delayed, EXACT))
    np.testing.assert_allclose(later[1:], sooner[:-1], atol=1e-4)


def test_velocity_approaches_its_command_exponentially() -> None:
    fine = replace(BARE, sub_steps=100)
    measured = drive(init(fine), jnp.zeros((ROWS, 6)).at[:, 0].set(1.0), fine)
    t = jnp.arange(ROWS + 1) * fine.time_step
    np.testing.assert_allclose(measured[:, 3], 1 - jnp.exp(-t / fine.base_lag[0]), atol=2e-3)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_positions_integrate_velocities(seed: int) -> None:
    measured = drive(init(EXACT), held_commands(seed), EXACT)
    for position, velocity in ((slice(0, 3), slice(3, 6)), (slice(6, 9), slice(9, 12))):
        v = measured[:, velocity]
        change = jnp.diff(measured[:, position], axis=0)
        change = jnp.arctan2(jnp.sin(change), jnp.cos(change))  # the yaw may have wrapped; a row's metres are few
        np.testing.assert_allclose(change, EXACT.time_step * (v[1:] + v[:-1]) / 2, atol=8e-3)
        np.testing.assert_allclose(change.sum(0), EXACT.time_step * ((v[1:] + v[:-1]) / 2).sum(0), atol=3e-2)


def test_more_sub_steps_change_little() -> None:
    fine = replace(EXACT, sub_steps=80)
    commands = held_commands(0)
    exact, coarse = (drive(init(config), commands, config)[:, :3] for config in (fine, EXACT))
    np.testing.assert_allclose(coarse, exact, atol=0.015)


def test_without_couplings_the_hand_is_carried_as_by_a_rigid_body() -> None:
    commands = held_commands(3).at[:, 3:].set(0.0)
    hand = hand_in_base_frame(drive(init(BARE), commands, BARE))
    np.testing.assert_allclose(hand, jnp.broadcast_to(jnp.array(BARE.home), hand.shape), atol=1e-4)


def test_an_accelerating_base_leaves_the_hand_behind() -> None:
    hand = hand_in_base_frame(drive(init(REACTING), jnp.zeros((ROWS, 6)).at[:, 0].set(1.0), REACTING))
    # The arm's lag turns a lost velocity of coupling * 1 m/s into a lost distance.
    lost = REACTING.base_arm_coupling * REACTING.arm_lag
    np.testing.assert_allclose(hand[-1, 0] - REACTING.home[0], -lost, atol=2e-3)


def test_a_moving_arm_disturbs_the_base_and_an_uncoupled_one_does_not() -> None:
    commands = jnp.zeros((ROWS, 6)).at[:10, 3:].set(0.8)
    np.testing.assert_array_equal(drive(init(BARE), commands, BARE)[:, :6], 0.0)
    assert (jnp.abs(drive(init(REACTING), commands, REACTING)[:, 3:6]).max(0) > 0.01).all()


@settings(max_examples=30, deadline=None)
@given(command=st.tuples(*[st.floats(-1.0, 1.0, width=32)] * 6))
def test_the_hand_stays_in_reach_and_off_the_floor(command: tuple[float, ...]) -> None:
    hand = hand_in_base_frame(drive(init(EXACT), jnp.tile(jnp.array(command), (ROWS, 1)), EXACT))
    distance = jnp.linalg.norm(hand - jnp.array(EXACT.shoulder), axis=1)
    # The limits are soft: reactions and stepping throw the hand past them by a few centimetres.
    assert distance.max() < EXACT.reach + 0.05
    assert distance.min() > EXACT.inner_reach - 0.05
    assert hand[:, 2].min() > 0.0


def test_stepping_shakes_a_walking_robot_and_stops_with_it() -> None:
    walk = jnp.zeros((ROWS, 6)).at[:25, 0].set(0.8)
    measured = drive(init(EXACT), walk, EXACT)
    assert measured[10:25, 4].std() > 0.02
    np.testing.assert_allclose(measured[-1, jnp.array([3, 4, 5, 9, 10, 11])], 0.0, atol=1e-3)


def test_measurement_noise_has_its_standard_deviation_and_yaw_wraps() -> None:
    config = VirtualSpotConfig()
    state = init(config)._replace(base_pose=jnp.array([0.0, 0.0, jnp.pi]))
    measured = jax.jit(jax.vmap(lambda key: measure(state, key, config)))(jax.random.split(KEY, 4000))
    assert jnp.abs(measured[:, 2]).max() <= np.float32(np.pi)
    assert measured[:, 2].min() < 0.0 < measured[:, 2].max()
    spread = measured.at[:, 2].set(jnp.mod(measured[:, 2], 2 * jnp.pi)).std(0)
    np.testing.assert_allclose(spread, config.base_measurement_noise + config.hand_measurement_noise, rtol=0.1)


def test_process_noise_is_drawn_from_the_key() -> None:
    config = VirtualSpotConfig()
    state, command = init(config), jnp.zeros(6)
    advance = jax.jit(lambda seed: step(state, command, jax.random.key(seed), config))
    once, again, other = (advance(seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(once.hand_velocity, again.hand_velocity)
    assert (once.base_velocity != other.base_velocity).all()


def test_gradients_at_rest_are_finite() -> None:
    measured_after = lambda state: measure(step(state, jnp.zeros(6), KEY, EXACT), KEY, EXACT).sum()  # noqa: E731
    gradient = jax.jit(jax.grad(measured_after))(init(EXACT))
    assert all(jnp.isfinite(part).all() for part in gradient)
    # Commands on their way act within the row.
    assert (jnp.abs(gradient.commands).max(0) > 0).all()
