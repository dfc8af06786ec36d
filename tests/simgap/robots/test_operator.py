"""Laws of the operator and of what the operator records."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from simgap.recordings import check_recording
from simgap.robots.operator import OperatorConfig, init, record, step
from simgap.robots.virtual_spot import VirtualSpotConfig
from simgap.simulators import spot
from simgap.simulators.spot import SCHEMA
from simgap.types import Recording

ROBOT, OPERATOR = VirtualSpotConfig(), OperatorConfig()
# Standard deviations of a real Spot's changes per row, taken at about 0.1 s a row, in the order of SCHEMA.
REAL_CHANGES = (0.057, 0.028, 0.03, 0.13, 0.086, 0.22, 0.062, 0.046, 0.027, 0.156, 0.211, 0.151)


@cache
def sessions(count: int = 6) -> tuple[Recording, ...]:
    keys = jax.random.split(jax.random.key(0), count)
    return tuple(record(key, 60.0, ROBOT, OPERATOR, f"session_{i}") for i, key in enumerate(keys))


def hand_in_base_frame(state: np.ndarray) -> np.ndarray:
    c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
    x, y = state[:, 6] - state[:, 0], state[:, 7] - state[:, 1]
    return np.stack([c * x + s * y, c * y - s * x, state[:, 8]], axis=1)


def test_a_session_is_determined_by_its_key() -> None:
    key = jax.random.split(jax.random.key(0), 6)[0]
    again, first, other = record(key, 60.0, ROBOT, OPERATOR, "again"), *sessions()[:2]
    np.testing.assert_array_equal(again.state, first.state)
    np.testing.assert_array_equal(again.command, first.command)
    assert (first.state != other.state).any(axis=0).all()
    assert (first.state[0] != other.state[0]).all()


@pytest.mark.parametrize("index", range(6))
def test_a_session_passes_the_checks_of_recordings(index: int) -> None:
    session = sessions()[index]
    values = np.column_stack([session.time_s, session.state, session.command])
    checked = check_recording(SCHEMA, session.name, dict(zip(SCHEMA.columns, values.T, strict=True)))
    assert len(checked.time_s) == 900
    np.testing.assert_allclose(checked.time_s, np.arange(900) / 15)


@pytest.mark.parametrize("index", range(6))
def test_base_stays_in_the_room_and_hand_in_reach(index: int) -> None:
    state = sessions()[index].state
    assert np.abs(state[:, :2]).max() < 2.5
    distance = np.linalg.norm(hand_in_base_frame(state) - ROBOT.shoulder, axis=1)
    assert distance.max() < ROBOT.reach + 0.05
    assert distance.min() > ROBOT.inner_reach - 0.05
    assert state[:, 8].min() > 0.0


def test_commands_are_smooth_and_use_the_sticks_travel() -> None:
    most = np.array(OPERATOR.most)
    command = np.concatenate([s.command for s in sessions()])
    assert (np.abs(command) <= most).all()
    assert (np.abs(command).max(0) > 0.9 * most).all()
    fastest = 1 - np.exp(-ROBOT.time_step / OPERATOR.stick_time)
    for session in sessions():
        assert (np.abs(np.diff(session.command, axis=0)) <= 2 * most * fastest + 1e-6).all()


def test_every_phase_occurs() -> None:
    command = np.concatenate([s.command for s in sessions()])
    base, arm = (np.abs(command[:, part]).max(1) > 0.01 for part in (slice(0, 3), slice(3, 6)))
    for phase in (base & ~arm, ~base & arm, base & arm, ~base & ~arm):
        assert phase.mean() > 0.02


def test_the_operator_steers_back_what_has_left_its_bounds() -> None:
    # Looking along the world's y axis, too far out in x: the room lies to the robot's left.
    base, hand = jnp.array([3.0, 0.0, jnp.pi / 2]), jnp.array([3.0, 1.5, 0.6])
    measured = jnp.concatenate([base, jnp.zeros(3), hand, jnp.zeros(3)])
    state = init()._replace(moving=jnp.ones(2), phase_left=jnp.array(9.0), goal_left=jnp.array(9.0))
    _, command = jax.jit(step, static_argnums=(3, 4))(state, measured, jax.random.key(0), ROBOT.time_step, OPERATOR)
    assert command[1] > 0.3
    assert command[3] < -0.3


def test_changes_are_of_a_real_spots_size() -> None:
    changes = np.concatenate([np.diff(s.state, axis=0) for s in sessions()])
    changes[:, 2] = np.angle(np.exp(1j * changes[:, 2]))
    ratio = changes.std(0) / (np.array(REAL_CHANGES) / 1.5)  # rows of 1/15 s instead of 0.1 s
    assert ratio.min() > 0.5
    assert ratio.max() < 2.0


def midrange() -> jax.Array:
    return jnp.array([(p.low + p.high) / 2 for p in spot.PARAMETERS])


def wrap_yaw(change: jax.Array) -> jax.Array:
    return change.at[:, 2].set(jnp.arctan2(jnp.sin(change[:, 2]), jnp.cos(change[:, 2])))


@jax.jit
def one_step_residuals(state: jax.Array, command: jax.Array) -> jax.Array:
    """Standard deviation of each output's residual under the kinematic model with its best parameters phi."""
    scale = wrap_yaw(jnp.diff(state, axis=0)).std(0)

    def residual(params: jax.Array) -> jax.Array:
        predicted = jax.vmap(lambda s, u: spot.step(params, s, u, ROBOT.time_step))(state[:-1], command[:-1])
        return (wrap_yaw(state[1:] - predicted) / scale).ravel()

    def gauss_newton(_: int, params: jax.Array) -> jax.Array:
        J = jax.jacfwd(residual)(params)
        return params - jnp.linalg.solve(J.T @ J, J.T @ residual(params))

    # A few steps do: the model is bilinear in its parameters.
    best = jax.lax.fori_loop(0, 5, gauss_newton, midrange())
    return (residual(best).reshape(-1, 12) * scale).std(0)


@jax.jit
def kinematic_twin(start: jax.Array, command: jax.Array) -> jax.Array:
    """The states under the same commands on the kinematic model with midrange parameters, as noisily measured."""

    def row(state: jax.Array, command: jax.Array) -> tuple[jax.Array, jax.Array]:
        return spot.step(midrange(), state, command, ROBOT.time_step), state

    state = jax.lax.scan(row, start, command)[1]
    scale = jnp.array(ROBOT.base_measurement_noise + ROBOT.hand_measurement_noise)
    return state + scale * jax.random.normal(jax.random.key(1), state.shape)


@pytest.mark.parametrize("index", range(6))
def test_the_kinematic_model_does_not_explain_the_robot(index: int) -> None:
    """Even its best fit leaves more than on a robot that *is* this model, with the same commands and noise."""
    state, command = (jnp.asarray(a, jnp.float32) for a in (sessions()[index].state, sessions()[index].command))
    virtual = one_step_residuals(state, command)
    twin = one_step_residuals(kinematic_twin(state[0], command), command)
    velocities = np.array([f.kind == "velocity" for f in SCHEMA.state])
    assert (virtual[velocities] > 2 * twin[velocities]).all()
    assert (virtual > 1.2 * twin).all()
