"""The geometry of a schema: motion by hand, in frames that move along with the world's, and pushes that undo it."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from examples.car import CAR
from examples.drive import DRIVE
from simgap.kinematics import carried_velocity, commanded, motion, push, to_own_frame, to_world, turned
from simgap.layout import Layout
from simgap.simulators.spot import SCHEMA as SPOT_SCHEMA
from simgap.types import Field, Schema

SPOT, CART, RAIL = Layout(SPOT_SCHEMA), Layout(CAR.schema), Layout(DRIVE.schema)
BARE = Layout(
    Schema((Field("tank", "m", "position", "world"), Field("flow", "m/s", "velocity", "world")),
           (Field("valve", "-", "position", "world"),))
)  # fmt: skip
"""No field says of which body it is."""
OMNI = Layout(
    Schema(
        (Field("x", "m", "position", "world", "cart", "x"), Field("y", "m", "position", "world", "cart", "y"),
         Field("yaw", "rad", "angle", "world", "cart", "yaw"), Field("vx", "m/s", "velocity", "world", "cart", "x"),
         Field("vy", "m/s", "velocity", "world", "cart", "y")),
        (Field("cmd_vx", "m/s", "velocity", "world", "cart", "x"),
         Field("cmd_vy", "m/s", "velocity", "world", "cart", "y")),
    )
)  # fmt: skip
"""A cart that turns, but is commanded in the world's frame."""

# Facing the world's y, walking and turning left; the hand 0.8 ahead and 0.1 to the left.
SPOT_STATE = jnp.array([1.0, 2.0, np.pi / 2, 0.3, 0.4, 0.5, 0.9, 2.8, 0.6, -0.2, 0.45, 0.05])

states = st.integers(0, 2**31 - 1).map(lambda seed: np.random.default_rng(seed).normal(size=12))
angles, shifts = st.floats(-3, 3), st.floats(-5, 5)
quick = settings(max_examples=20, deadline=None)


def turn(xy: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * xy[0] - s * xy[1], s * xy[0] + c * xy[1]])


def moved(layout: Layout, state: np.ndarray, angle: float, shift: float) -> np.ndarray:
    """The state seen from a world frame that lies elsewhere."""
    out = np.array(state, float)
    for b in range(len(layout.bodies)):
        for table, by in ((layout.position, shift), (layout.velocity, 0.0)):
            ix, iy = table[b, :2]
            if ix >= 0 and iy >= 0 and layout.schema.state[ix].frame == "world":
                out[[ix, iy]] = turn(out[[ix, iy]], angle) + by
        if layout.position[b, 3] >= 0:
            out[layout.position[b, 3]] += angle
    return out


# By hand


def test_motion_along_an_own_axis_shows_in_both_of_the_worlds() -> None:
    base, hand = (SPOT.bodies.index(b) for b in ("base", "ee"))
    assert SPOT.outputs(base, (0,)) == ("base_vx",)
    assert SPOT.shown_in(base, (0,)) == SPOT.shown_in(base, (1,)) == ("base_vx", "base_vy")
    assert SPOT.shown_in(hand, (1, 2)) == ("ee_vx", "ee_vy", "ee_vz")
    assert SPOT.shown_in(base, (3,)) == ("base_wz",)
    assert RAIL.shown_in(0, (0,)) == RAIL.outputs(0, (0,)) == ("velocity",)


def test_spots_motion_by_hand() -> None:
    own = motion(SPOT, SPOT_STATE)
    # The base's world velocity (0.3, 0.4) is 0.4 ahead and 0.3 to the right. Rigidly with it the hand would move at
    # (0.4, -0.3) + 0.5 (-0.1, 0.8) = (0.35, 0.1); it moves at (0.45, 0.2).
    np.testing.assert_allclose(own.velocity, [[0.4, -0.3, 0, 0.5], [0.1, 0.1, 0.05, 0]], atol=1e-6)
    np.testing.assert_allclose(own.position, [[0, 0, 0], [0.8, 0.1, 0.6]], atol=1e-6)
    np.testing.assert_allclose(own.heading, [np.pi / 2] * 2, rtol=1e-6)


def test_spots_base_carries_the_hand() -> None:
    expected = np.zeros(12)
    expected[9:11] = [0.3 - 0.5 * 0.8, 0.4 - 0.5 * 0.1]  # V + w x r, r = (-0.1, 0.8) in the world
    np.testing.assert_allclose(carried_velocity(SPOT, SPOT_STATE, SPOT_STATE), expected, atol=1e-6)


def test_carried_velocity_takes_places_from_one_state_and_velocities_from_another() -> None:
    faster = SPOT_STATE.at[3:6].multiply(2).at[:3].set(9.0).at[6:9].set(9.0)
    once, twice = (carried_velocity(SPOT, SPOT_STATE, s) for s in (SPOT_STATE, faster))
    np.testing.assert_allclose(twice, 2 * once, atol=1e-6)


def test_turning_spots_velocities_by_hand() -> None:
    got = turned(SPOT, SPOT_STATE, jnp.array([np.pi / 2, -np.pi / 2]))
    expected = np.array(SPOT_STATE)
    expected[[3, 4, 9, 10]] = [-0.4, 0.3, 0.45, 0.2]
    np.testing.assert_allclose(got, expected, atol=1e-6)


def test_pushes_enter_spots_commands() -> None:
    delta = jnp.array([[0.1, 0.2, 0.3, 0.4], [0.5, 0.6, 0.7, 0.8]])
    u, v, p = push(SPOT, jnp.full(2, 0.7), delta)
    # No base height and no yaw of the hand: 0.3 and 0.8 act nowhere.
    np.testing.assert_allclose(u, [0.1, 0.2, 0.4, 0.5, 0.6, 0.7], rtol=1e-6)
    assert not v.any()
    assert not p.any()


def test_car_moves_along_its_yaw() -> None:
    state = jnp.array([1.0, 2.0, 0.7, 1.5])
    own = motion(CART, state)
    np.testing.assert_allclose(own.velocity, [[1.5, 0, 0, 0]])
    np.testing.assert_allclose(own.position, [[0, 0, 0]])
    np.testing.assert_allclose(own.heading, [0.7], rtol=1e-6)
    np.testing.assert_array_equal(turned(CART, state, jnp.ones(1)), state)  # its velocity is no world vector
    assert not carried_velocity(CART, state, state).any()


def test_pushes_on_the_car_enter_its_speed_or_turn_it() -> None:
    u, v, p = push(CART, jnp.zeros(1), jnp.array([[0.1, 0.2, 0.3, 0.4]]))
    np.testing.assert_allclose(u, [0.1, 0.0], rtol=1e-6)  # nothing on the steering
    assert not v.any()
    np.testing.assert_allclose(p, [0.0, 0.2, 0.4, 0.0], rtol=1e-6)


@given(angles)
@quick
def test_pushes_on_positions_turn_with_the_car(heading: float) -> None:
    _, _, p = push(CART, jnp.array([heading]), jnp.array([[0.0, 0.2, 0.0, 0.0]]))
    np.testing.assert_allclose(p[:2], 0.2 * np.array([-np.sin(heading), np.cos(heading)]), atol=1e-6)


def test_drive_has_no_frame_but_the_worlds() -> None:
    state = jnp.array([0.3, -0.5])
    own = motion(RAIL, state)
    np.testing.assert_allclose(own.velocity, [[-0.5, 0, 0, 0]])
    np.testing.assert_allclose(own.heading, [0])
    u, v, p = push(RAIL, own.heading, jnp.array([[0.7, 0.2, 0.3, 0.4]]))
    np.testing.assert_allclose(u, [0.7], rtol=1e-6)
    assert not v.any()
    assert not p.any()
    np.testing.assert_array_equal(turned(RAIL, state, jnp.ones(1)), state)
    assert not carried_velocity(RAIL, state, state).any()


def test_without_bodies_there_is_no_motion_and_nothing_to_push() -> None:
    state = jnp.array([0.4, 0.2])
    own = motion(BARE, state)
    assert [a.shape for a in own] == [(0, 4), (0, 3), (0,)]
    assert not np.concatenate([a.ravel() for a in push(BARE, own.heading, own.velocity)]).any()
    np.testing.assert_array_equal(turned(BARE, state, jnp.zeros(0)), state)
    assert not carried_velocity(BARE, state, state).any()
    assert (BARE.integrates == -1).all()


def test_what_integrates_what() -> None:
    names = [f.name for f in SPOT_SCHEMA.state]
    pairs = {names[p]: names[v] for p, v in enumerate(SPOT.integrates) if v >= 0}
    assert pairs == {
        "base_x": "base_vx", "base_y": "base_vy", "base_yaw": "base_wz",
        "ee_x": "ee_vx", "ee_y": "ee_vy", "ee_z": "ee_vz",
    }  # fmt: skip
    assert list(CART.integrates) == [-1, -1, -1, -1]  # its speed is no component of (x', y')
    assert list(RAIL.integrates) == [1, -1]


# Frames


@given(states, angles, shifts)
@quick
@pytest.mark.parametrize("layout", [SPOT, CART], ids=["spot", "car"])
def test_own_motion_is_the_same_wherever_the_world_frame_lies(
    layout: Layout, state: np.ndarray, angle: float, shift: float
) -> None:
    state = state[: len(layout.schema.state)]
    here, there = (motion(layout, jnp.asarray(s)) for s in (state, moved(layout, state, angle, shift)))
    np.testing.assert_allclose(here.velocity, there.velocity, atol=1e-5)
    np.testing.assert_allclose(here.position, there.position, atol=1e-5)
    np.testing.assert_allclose(here.heading + angle, there.heading, atol=1e-5)


@given(states, shifts)
@quick
def test_own_motion_on_a_rail_is_the_same_wherever_it_starts(state: np.ndarray, shift: float) -> None:
    here, there = (motion(RAIL, jnp.array([state[0] + by, state[1]])) for by in (0.0, shift))
    np.testing.assert_array_equal(here.velocity, there.velocity)
    np.testing.assert_array_equal(here.position, there.position)


@given(states, angles, shifts)
@quick
def test_carried_velocity_turns_with_the_world_frame(state: np.ndarray, angle: float, shift: float) -> None:
    there = jnp.asarray(moved(SPOT, state, angle, shift))
    carried = np.asarray(carried_velocity(SPOT, there, there))
    here = np.asarray(carried_velocity(SPOT, jnp.asarray(state), jnp.asarray(state)))
    np.testing.assert_allclose(carried[9:11], turn(here[9:11], angle), atol=1e-4)


@given(states)
@quick
def test_what_the_base_carries_is_no_motion_of_the_hand(state: np.ndarray) -> None:
    """A hand that moves as its base carries it does not move in its own frame."""
    carried = carried_velocity(SPOT, jnp.asarray(state), jnp.asarray(state))
    rigid = jnp.asarray(state, jnp.float32).at[9:11].set(carried[9:11])
    np.testing.assert_allclose(motion(SPOT, rigid).velocity[1, :2], [0, 0], atol=1e-5)


def test_bodies_may_come_in_any_order() -> None:
    order = [*range(6, 12), *range(6)]
    swapped = Layout(replace(SPOT_SCHEMA, state=tuple(SPOT_SCHEMA.state[i] for i in order)))
    assert swapped.bodies == ("ee", "base")
    here, there = motion(SPOT, SPOT_STATE), motion(swapped, SPOT_STATE[jnp.array(order)])
    np.testing.assert_allclose(here.velocity, there.velocity[::-1], atol=1e-6)
    np.testing.assert_allclose(here.position, there.position[::-1], atol=1e-6)


def test_a_resistance_opposes_motion_where_commands_are_in_the_world_frame() -> None:
    state = jnp.array([0.0, 0.0, np.pi / 2, 0.3, 0.0])  # facing the world's y, moving along its x
    own = motion(OMNI, state)
    u, _, _ = push(OMNI, own.heading, -own.velocity)
    np.testing.assert_allclose(u, [-0.3, 0.0], atol=1e-6)


@given(angles)
@quick
def test_commands_in_the_world_frame_are_read_in_the_bodys_own(heading: float) -> None:
    delta = jnp.array([0.3, -0.2, 0.0, 0.0])
    u, _, _ = push(OMNI, jnp.array([heading]), delta[None])
    np.testing.assert_allclose(commanded(OMNI, 0, jnp.asarray(heading), u), delta, atol=1e-6)
    np.testing.assert_array_equal(commanded(CART, 0, jnp.asarray(heading), u), [u[0], 0, 0, 0])


@given(angles)
@quick
def test_no_part_of_a_push_is_lost_or_counted_twice(heading: float) -> None:
    """A cart that knows its speed along the world's x only: there a velocity is pushed, along y a position."""
    half = Layout(Schema(tuple(f for f in OMNI.schema.state if f.name != "vy"), ()))
    _, v, p = push(half, jnp.array([heading]), jnp.array([[0.3, -0.2, 0.0, 0.5]]))
    x, y = turn(np.array([0.3, -0.2]), heading)
    np.testing.assert_allclose(v, [0, 0, 0, x], atol=1e-6)
    np.testing.assert_allclose(p, [0, y, 0.5, 0], atol=1e-6)


# What moves together


def test_what_is_measured_of_a_body_tells_of_what_it_carries_and_of_nothing_else() -> None:
    names = [f.name for f in SPOT_SCHEMA.state]
    akin = {(names[i], names[j]) for i, j in SPOT.akin}
    assert {("ee_vx", "base_vx"), ("base_vx", "base_x"), ("ee_y", "base_yaw"), ("ee_z", "ee_vz")} <= akin
    assert not akin & {("ee_z", "base_x"), ("base_x", "base_y"), ("ee_vz", "base_wz")}
    assert len(akin) == len(SPOT.akin) == 4 * 3 + 6 * 5 + 2
    assert len(RAIL.akin) == 2
    assert not BARE.akin
    assert not any(layout.apart.any() for layout in (SPOT, RAIL, BARE))


@quick
@given(states, states)
def test_own_frames_and_back_is_no_turn(state: np.ndarray, vector: np.ndarray) -> None:
    own = to_own_frame(SPOT, jnp.asarray(vector), jnp.asarray(state))
    np.testing.assert_allclose(to_world(SPOT, own, jnp.asarray(state)), vector, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(own), np.linalg.norm(vector), rtol=1e-5)
