"""A twin on a robot whose truth is known: the kinematic model, late sensors, rows that stall."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from jaxtyping import Array

from simgap.recordings import HISTORY, encode_state
from simgap.residual import config as residual
from simgap.residual import duration
from simgap.robots.twin import rows, score
from simgap.robots.twin.config import Config
from simgap.robots.twin.fit import fit
from simgap.robots.twin.model import SHOULDER, Twin, departed, departure, measured, true, within, wrapped
from simgap.robots.twin.robot import TwinRobot
from simgap.robots.twin.windows import cut, errors, predict
from simgap.simulators import parameter_ranges
from simgap.simulators.spot import SCHEMA, Spot, to_body
from simgap.types import ConfigError, DivergenceError, Recording, RecordingError

SPOT = Spot()
PHI = jnp.asarray(np.mean(parameter_ranges(SPOT), axis=0))
AGES, STALL, ROWS = jnp.array([0.05, 0.08]), 3.0, 80
LIMIT = (1.0, 0.8, 1.0, 0.8, 0.8, 0.8)
CONFIG = Config(
    horizon=12, stride=4, training_steps=120, evaluate_every=40, batch_size=32, simulator_learning_rate=2e-2,
    learning_rate=5e-3, weight_decay=0.1, hidden_layer_sizes=(8,), heldout_share=0.3, folds=2, replays=8,
)  # fmt: skip
OF_ROWS = residual.Config(
    simulator_steps=400, simulator_learning_rate=2e-2, simulator_batch=128, durations=8, outputscales=(0.1,),
    lengthscales=(2.0,), training_steps=1, evaluate_every=1, patience=1, measurement_points=1, heldout_share=0.2,
    paces=(1.0,), horizon=10,
)  # fmt: skip
STATES = arrays(np.float64, 12, elements=st.floats(-3, 3))


@jax.jit
def _truth(state: Array, commands: Array, steps: Array) -> Array:
    """The state that the kinematic model reaches after `steps` steps."""
    x = jnp.concatenate([encode_state(SCHEMA, state), commands.reshape(-1)])
    change = duration.after(duration.path(SPOT, PHI, x), steps[None])[0]
    yaw = jnp.arctan2(x[2] + change[2], x[3] + change[3])
    then = x[:13] + change
    return jnp.concatenate([then[:2], yaw[None], then[4:]])


def session(seed: int) -> tuple[Recording, np.ndarray]:
    """A session of `ROWS` rows, every fifth of which stalls, with late sensors and noise; and the rows' durations."""
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.normal(0, 0.12, (ROWS, 6)), axis=0).clip(-0.6, 0.6)
    steps = np.where(np.arange(ROWS - 1) % 5 == 2, STALL, 1.0)
    state = jnp.zeros(12).at[6].set(0.9).at[8].set(0.6)
    states = [state]
    for t in range(ROWS - 1):
        sent = u[[max(t - 2, 0), max(t - 1, 0), t]]
        state = _truth(state, jnp.asarray(sent), jnp.asarray(steps[t]))
        states.append(state)
    said = np.stack([measured(s, AGES) for s in states])
    noise = np.tile([0.001] * 3 + [0.004] * 3, 2)
    said = said + noise * rng.normal(size=said.shape)
    said[:, 2] = (said[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return Recording(f"s{seed}", np.arange(ROWS) / 15, said, u), steps


@cache
def sessions() -> tuple[tuple[Recording, ...], tuple[np.ndarray, ...]]:
    recorded, steps = zip(*(session(seed) for seed in range(6)), strict=True)
    return recorded, steps


@cache
def twin() -> Twin:
    recorded, _ = sessions()
    return fit(jax.random.key(0), recorded[:5], recorded[:4], SPOT, (CONFIG, OF_ROWS), lambda *_: None)


@given(STATES, st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)))
def test_what_late_sensors_say_is_undone(state: np.ndarray, ages: tuple[float, float]) -> None:
    there = measured(true(jnp.asarray(state), jnp.asarray(ages)), jnp.asarray(ages))
    np.testing.assert_allclose(there, wrapped(jnp.asarray(state)), atol=1e-5)


@given(STATES, st.floats(0.3, 2.0))
def test_a_hand_ends_where_the_arm_does(state: np.ndarray, reach: float) -> None:
    kept = within(jnp.asarray(state), jnp.asarray(reach))
    arm, before = (np.asarray(to_body(s))[6:9] - SHOULDER for s in (kept, jnp.asarray(state)))
    assert np.linalg.norm(arm) <= reach + 1e-4
    if np.linalg.norm(before) <= reach:
        np.testing.assert_array_equal(kept, jnp.asarray(state))
    else:
        np.testing.assert_allclose(np.cross(arm, before), 0, atol=1e-4)  # it stays on its line
        then = np.asarray(to_body(jnp.asarray(kept)))
        carried = np.array([then[3] - then[5] * before[1], then[4] + then[5] * (before[0] + SHOULDER[0]), 0])
        carried[0] -= then[5] * SHOULDER[1]
        assert (then[9:] - carried) @ arm <= 1e-3 * (1 + np.abs(then).max()) * reach


@given(STATES, STATES, STATES)
def test_a_departure_leads_to_what_really_came(state: np.ndarray, then: np.ndarray, real: np.ndarray) -> None:
    missed = departure(*map(jnp.asarray, (state, then, real)))
    away = wrapped(departed(jnp.asarray(state), jnp.asarray(then), missed) - jnp.asarray(real))
    np.testing.assert_allclose(np.abs(away), 0, atol=2e-5)


@given(st.floats(-3, 3), STATES, STATES, STATES)
def test_departures_do_not_depend_on_where_the_robot_looks(
    turn: float, state: np.ndarray, then: np.ndarray, real: np.ndarray
) -> None:
    """Robot and world turned together give the same departure."""

    def turned(s: np.ndarray) -> Array:
        c, n = np.cos(turn), np.sin(turn)
        R = np.array([[c, -n, 0], [n, c, 0], [0, 0, 1]])
        out = (s.reshape(4, 3) @ R.T).reshape(-1)
        return jnp.asarray(out).at[2].add(turn)

    plain = departure(*map(jnp.asarray, (state, then, real)))
    np.testing.assert_allclose(departure(*map(turned, (state, then, real))), plain, atol=5e-5)


@pytest.mark.long
def test_rows_that_stalled_are_found() -> None:
    recorded, steps = sessions()
    found = rows.timed(twin().model, recorded[0]).duration[HISTORY:]
    really = steps[0][HISTORY:] == STALL
    moving = np.abs(recorded[0].command[HISTORY:-1]).max(1) > 0.2
    # The unit is the fitted simulator's step: what counts is the ratio.
    ratio = np.median(found[really & moving]) / np.median(found[~really & moving])
    assert ratio == pytest.approx(STALL, rel=0.1)
    assert ((found > 2 * np.median(found)) == really)[moving].mean() > 0.9


@pytest.mark.long
def test_late_sensors_are_found_to_be_late() -> None:
    """The hand's more than the base's; by how much depends on how the fitted simulator integrates velocities."""
    base, hand = twin().ages
    assert 0.005 < base < hand < 2 * AGES[1]


def test_a_twin_predicts_a_session_it_was_not_given() -> None:
    recorded, _ = sessions()
    known = score.multi_step(twin(), recorded[5:], (12,), 3, known=True)
    unknown = score.multi_step(twin(), recorded[5:], (12,), 3, known=False)
    s = recorded[5].state
    moved = np.linalg.norm(s[12:, 6:9] - s[:-12, 6:9], axis=1).mean()
    assert known["rollout_ee_12"] < 0.15 * moved
    assert known["rollout_ee_12"] < unknown["rollout_ee_12"]


def test_a_session_that_is_replayed_is_repeated() -> None:
    """Its own commands, durations and departures: nothing is left to be missed."""
    recorded, _ = sessions()
    timed, own = rows.timed(twin().model, recorded[0]), twin()
    windows = cut([timed], 30, ROWS)
    missed = rows.missed(own.model, own.ages, own.reach, timed)[None, :30]
    np.testing.assert_allclose(
        errors(predict(own.model, own.ages, own.reach, windows, jnp.asarray(missed)), windows), 0, atol=2e-4
    )
    assert np.abs(errors(predict(own.model, own.ages, own.reach, windows), windows)).max() > 1e-2


def test_replays_hold_what_was_measured_about_as_often_as_they_say() -> None:
    recorded, _ = sessions()
    inside = score.coverage(jax.random.key(1), twin(), recorded[5:], 12, 3, 40)
    assert 0.6 < inside["coverage_base_12"] <= 1
    assert 0.6 < inside["coverage_ee_12"] <= 1


def test_a_twin_is_a_robot() -> None:
    robot = TwinRobot(jax.random.key(3), twin(), LIMIT)
    forward = np.array([5.0, 0, 0, 0, 0, 0])
    first = robot.observe()
    assert np.hypot(*first[:2]) < 0.01
    np.testing.assert_allclose(robot.command(forward), [1.0, 0, 0, 0, 0, 0])
    for _ in range(9):
        robot.command(forward)
    there = robot.observe()
    assert there[0] > 0.3
    arm = np.asarray(to_body(jnp.asarray(there)))[6:9] - SHOULDER
    assert np.linalg.norm(arm) < float(twin().reach) + 0.05
    robot.stop()
    robot.reset()
    np.testing.assert_array_equal(robot.observe(), first)
    for _ in range(10):
        robot.command(forward)
    np.testing.assert_array_equal(robot.observe(), there)
    other = TwinRobot(jax.random.key(4), twin(), LIMIT)
    for _ in range(10):
        other.command(forward)
    assert (other.observe() != there).any()


def test_a_twins_rows_last_as_long_as_the_robots_did() -> None:
    """The kinematic model's positions go gamma times 1/15 s of their velocities a step."""
    gamma, (_, steps) = float(PHI[18]), sessions()
    assert rows.seconds(sessions()[0]) == pytest.approx(gamma * np.mean(steps) / 15, rel=0.15)
    assert TwinRobot(jax.random.key(0), twin(), LIMIT).time_step == pytest.approx(rows.seconds(sessions()[0][:4]))


def test_sessions_too_short_for_a_window_are_named() -> None:
    """In pieces that have as many transitions as the twin's sessions, so that they share what is compiled."""
    recorded, _ = sessions()
    parts = [(r, slice(t, t + 14)) for r in recorded[:5] for t in range(0, ROWS - 13, 11)]
    short = [r._replace(state=r.state[s], command=r.command[s], time_s=r.time_s[s]) for r, s in parts]
    with pytest.raises(RecordingError, match="0 of 35 sessions have more than 14 rows; a twin needs two"):
        fit(jax.random.key(0), short, short, SPOT, (CONFIG, OF_ROWS), lambda *_: None)


def test_a_fit_that_leaves_the_finite_numbers_says_so() -> None:
    recorded, _ = sessions()
    wild = [r._replace(state=np.where(np.arange(12) == 4, 1e30, r.state)) for r in recorded[:5]]
    with pytest.raises(DivergenceError):
        fit(jax.random.key(0), wild, wild, SPOT, (CONFIG, OF_ROWS), lambda *_: None)


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [("folds", 1, "at least 2"), ("horizon", 0, "above 0"), ("heldout_share", 1.0, "below 1"),
     ("evaluate_every", 999, "at most")],
)  # fmt: skip
def test_impossible_numbers_are_refused(key: str, value: float, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        Config(**{**CONFIG.__dict__, key: value})
