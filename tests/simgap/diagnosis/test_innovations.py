"""Innovations vanish where nothing is unknown; every transition counts once; their derivatives are derivatives."""

from functools import cache, reduce

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from planted import PHI, SCALES, SPOT, theta
from small import KEYS, acting, innovations, sessions

from examples.drive import DRIVE
from simgap.diagnosis.likelihood.derivatives import nuisance_columns
from simgap.diagnosis.likelihood.directions import directions, spans
from simgap.diagnosis.likelihood.filter import alone, corrected, filtered, gain_matrix
from simgap.diagnosis.likelihood.problem import Problem, trials
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import (
    FEW,
    LENGTH,
    SIZES,
    TURNS,
    WARM,
    as_chunks,
    cut,
    filled,
    scorable,
    sent_before,
)
from simgap.diagnosis.likelihood.variables import Variables
from simgap.effects import CATALOGUE
from simgap.effects.augmented import Augmented, Slot
from simgap.effects.effect import HISTORY_ROWS, Earlier, Row
from simgap.effects.step import advance, fading, remember
from simgap.kinematics import wrapped
from simgap.rows import by_row
from simgap.types import Recording

LET_IN = 24
"""Rows after a session's start that commands from before it, of which nothing is known, may still be felt in."""
FORGOTTEN = {"sensor_delay": 1e-3}
"""The measured start is no state where measurements are late: it is forgotten, not right."""


def truth(constants: dict) -> Variables:
    return Variables(
        PHI,
        np.full(12, 0.5, np.float32),
        np.zeros(44, np.float32),
        theta(constants),
        np.zeros((1, len(SPOT.slots)), np.float32),
    )


def everywhere(key: str) -> dict:
    """An effect at all its sites, at the middle of its starts: the first and last may be hardly felt."""
    sites = SPOT.sites[[e.key for e in CATALOGUE].index(key)]
    if key.startswith("payload"):
        return acting(key, (0.2, 0.05, 5.0))
    constants: dict = {}
    for s in range(len(sites)):
        starts = KEYS[key].starts(SCALES, s)
        constants |= acting(key, tuple(starts[REMEMBERED.get(key, len(starts) // 2)]), (s,))
    return constants


REMEMBERED = {"resonance": 0, "lag": 1, "sensor_delay": 1}
"""Starts with a short memory: what comes before a session is not recorded, so even true constants leave something."""


@cache
def nothing_planted() -> tuple[Recording, ...]:
    return tuple(sessions({})[0])


def seen(constants: dict, recordings: list[Recording]) -> np.ndarray:
    """Innovations [n, s], without the rows that follow a session's start."""
    chunks = cut(recordings, 1 / 15)
    e = np.asarray(innovations(SPOT, SCALES, truth(constants), chunks))
    successor = np.asarray(chunks.row)[:, None] + 1 + np.arange(e.shape[1])
    return e[np.asarray(chunks.counts) & (successor > LET_IN)]


# Here rows are evenly spaced, so that `stamped` does nothing: see below. Where a sensor folds, the signs at the starts
# are found first: see test_rectified.
OTHERS = [
    e.key
    for e, sites in zip(CATALOGUE, SPOT.sites, strict=True)
    if sites and e.key != "sampling_interval.stamped" and not e.folds
]


@pytest.mark.parametrize("key", OTHERS)
def test_with_true_constants_and_no_noise_innovations_vanish(key: str) -> None:
    constants = everywhere(key)
    recorded, _ = sessions(constants, seed=1, noise=0.0)
    error = np.abs(seen(constants, recorded)).max()
    assert error < FORGOTTEN.get(key, 1e-5)
    assert np.abs(seen({}, recorded)).max() > 10 * max(error, 1e-4)


def test_several_effects_at_once_leave_nothing_either() -> None:
    constants = {
        **acting("delay", (1.3,), (0, 1, 2)), **acting("lag", (1.1,), (3, 4, 5)), **acting("saturation", (1.6,)),
        **acting("coulomb_friction", (0.03,), (0, 1)), **acting("gravity_sag", (0.05,)),
        **acting("slope", (0.05, 0.02)), **acting("ground_contact", (0.85,)),
        **acting("integration_rule", (0.5,), (0, 1)),
        **acting("sensor_bias", (0.03,), (10,)), **acting("sensor_scale", (0.05,), (4,)),
    }  # fmt: skip
    recorded, _ = sessions(constants, seed=2, noise=0.0)
    assert np.abs(seen(constants, recorded)).max() < 1e-5


@pytest.mark.long
def test_rows_that_are_unevenly_spaced_advance_by_their_own_interval() -> None:
    augmented, phi = Augmented(DRIVE), jnp.array([2.0, 4.0])
    rng = np.random.default_rng(0)
    interval, command = rng.uniform(0.5, 2.0, 99), rng.normal(size=(100, 1)).astype(np.float32)
    time_s = DRIVE.time_step * np.concatenate([[0], np.cumsum(interval)])
    (e,) = (i for i, effect in enumerate(CATALOGUE) if effect.key == "sampling_interval.stamped")
    on = jnp.zeros(len(augmented.slots)).at[augmented.index[Slot(e, 0, 0)]].set(1.0)
    state, states = jnp.zeros(2), [np.zeros(2)]
    memory = remember(
        augmented, fading(augmented, phi, on), on, state, Earlier(jnp.zeros((HISTORY_ROWS + 1, 1))), jnp.zeros(())
    )
    still = measure(augmented, [Recording("a", time_s, np.zeros((100, 2)), command)])
    for t in range(99):
        row = Row(jnp.asarray(time_s[t]), jnp.asarray(interval[t], jnp.float32))
        memory, state = advance(augmented, phi, on, still, memory, state, jnp.asarray(command[t]), row)
        states.append(np.asarray(state))
    chunks = cut([Recording("a", time_s, np.array(states), command)], DRIVE.time_step)
    none = jnp.zeros(len(augmented.slots))
    as_stamped, as_nominal = (
        np.abs(
            innovations(
                augmented,
                still,
                Variables(np.asarray(phi), np.full(2, 0.5), np.zeros(2), np.asarray(c), np.asarray(none)[None]),
                chunks,
            )
        ).max()
        for c in (on, none)
    )
    assert as_stamped < 1e-5
    assert as_nominal > 1e-4


# Chunks


def session(name: int, rows: int, columns: tuple[int, int] = (12, 6)) -> Recording:
    """A session whose states say which session and row they are."""
    state = np.zeros((rows, columns[0]))
    state[:, 0], state[:, 1] = name, np.arange(rows)
    command = np.tile(np.arange(rows)[:, None], (1, columns[1])).astype(float)
    return Recording(str(name), np.arange(rows) / 15, state, command)


@given(st.lists(st.integers(2, 170), min_size=1, max_size=4))
@example([2])  # a single transition
@example([LENGTH, 2 * LENGTH, LENGTH + 1, 2 * LENGTH + 1])
@example([LENGTH + 2, 2 * LENGTH + 2])  # a chunk begins at the last transition
@settings(max_examples=40, deadline=None)
def test_every_transition_counts_once_and_none_crosses_sessions(rows: list[int]) -> None:
    chunks = cut([session(s, n) for s, n in enumerate(rows)], 1 / 15)
    assert len(chunks.state) == filled(len(chunks.state))
    state, counts = np.asarray(chunks.state), np.asarray(chunks.counts)
    for s, n in enumerate(rows):
        before, after = (part[counts & (state[:, 1:, 0] == s)] for part in (state[:, :-1], state[:, 1:]))
        assert (before[:, 0] == s).all()
        np.testing.assert_array_equal(after[:, 1], before[:, 1] + 1)
        # The first rows let the estimate in.
        np.testing.assert_array_equal(np.sort(after[:, 1]), np.arange(3, n))


@given(st.lists(st.integers(2, 900), min_size=1, max_size=4), st.integers(1, 12))
@settings(max_examples=30, deadline=None)
def test_of_many_rows_segments_at_regular_intervals_are_searched(rows: list[int], segments: int) -> None:
    recordings = [session(s, n) for s, n in enumerate(rows)]
    everything, some = (cut(recordings, 1 / 15, most=most) for most in (10**6, segments * LENGTH))
    assert np.asarray(everything.counts).sum() == scorable(recordings)
    used = np.asarray(some.counts).any(1)
    assert used.sum() <= segments
    of: dict[tuple[int, int], int] = {}
    for i, place in enumerate(zip(everything.session, everything.row, strict=True)):
        of.setdefault(place, i)  # segments that pad the number repeat the first
    places = sorted(of[s, r] for s, r in zip(some.session[used], some.row[used], strict=True))
    # They are evenly spaced, up to rounding, and up to segments without a scored row.
    assert np.ptp(np.diff(places)) <= 2 if len(places) > 1 and min(rows) > LENGTH else len(places) == used.sum()
    for field in ("state", "command", "past", "turns", "interval"):
        found = np.asarray(getattr(some, field))[used]
        whole = [of[s, r] for s, r in zip(some.session[used], some.row[used], strict=True)]
        np.testing.assert_array_equal(found, np.asarray(getattr(everything, field))[whole])


@given(st.lists(st.integers(30, 170), min_size=1, max_size=3))
@settings(max_examples=20, deadline=None)
def test_chunks_know_where_they_come_from(rows: list[int]) -> None:
    chunks = cut([session(s, n) for s, n in enumerate(rows)], 1 / 15)
    state, used = np.asarray(chunks.state), np.asarray(chunks.counts).any(1)
    np.testing.assert_array_equal(state[:, 0, 0], chunks.session)
    np.testing.assert_array_equal(state[:, 0, 1], chunks.row)
    np.testing.assert_allclose(np.asarray(chunks.time_s)[:, 0], chunks.row / 15, rtol=1e-5)
    np.testing.assert_array_equal(chunks.command[..., 0], state[..., 1])
    # Commands before the chunk's first, the latest first; before the session, its first.
    past = np.maximum(chunks.row[:, None] - 1 - np.arange(chunks.past.shape[1]), 0)
    np.testing.assert_array_equal(np.asarray(chunks.past)[used, :, 0], past[used])
    # Rows only rise: the last one, then the first.
    before, oldest = np.asarray(chunks.came)[used, 0, 1], np.asarray(chunks.came)[used, 1:, 1]
    assert (np.abs(before - past[used, 0]) <= 1).all()
    assert (oldest == 0).all()
    np.testing.assert_allclose(chunks.interval, 1, atol=1e-4)


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=300), st.sampled_from([0.0, 1.0, 2.0, 3.5, 7.0]))
@settings(max_examples=60, deadline=None)
def test_turning_points_tell_where_play_stands(commands: list[int], gap: float) -> None:
    """Whatever the gap, and however long ago the command turned: as if it had seen every row since it stood still."""
    command = np.array(commands, float)[:, None]
    played = lambda z, rows: reduce(lambda z, u: np.clip(z, u - gap / 2, u + gap / 2), rows, z)  # noqa: E731
    _, turns = sent_before(np.concatenate([command, np.zeros((WARM, 1))]), len(command) + WARM)
    assert turns.shape == (TURNS, 1)
    assert turns[-1] == 0
    np.testing.assert_array_equal(played(np.zeros(1), turns[::-1]), played(np.zeros(1), command))


def test_rows_that_do_not_count_are_zero() -> None:
    chunks = cut(nothing_planted(), 1 / 15)
    e = np.asarray(innovations(SPOT, SCALES, truth({}), chunks))
    counts = np.asarray(chunks.counts)
    assert not e[~counts].any()
    assert e[counts].all(1).mean() > 0.99


# Angles


def test_differences_of_angles_are_wrapped() -> None:
    difference = np.tile(np.array([0.1, 3.0, -3.5, 6.4, 2 * np.pi - 0.1])[:, None], (1, 12))
    found = by_row(wrapped, SPOT.layout, difference)
    np.testing.assert_allclose(
        found[:, 2], [0.1, 3.0, 2 * np.pi - 3.5, 6.4 - 2 * np.pi, -0.1], atol=1e-5
    )  # only the yaw is an angle
    np.testing.assert_allclose(np.delete(found, 2, axis=1), np.delete(difference, 2, axis=1), rtol=1e-6)


def test_innovations_do_not_depend_on_how_often_the_robot_has_turned() -> None:
    recorded = nothing_planted()
    rng = np.random.default_rng(0)
    turned = []
    for r in recorded:
        state = r.state.copy()
        state[:, 2] += 2 * np.pi * rng.integers(-1, 2, len(state))
        turned.append(r._replace(state=state))
    a, b = (np.asarray(innovations(SPOT, SCALES, truth({}), cut(r, 1 / 15))) for r in (recorded, turned))
    np.testing.assert_allclose(a, b, atol=1e-4)


# Derivatives


SMOOTH = ("delay", "lag", "gain", "viscous_drag", "gravity_sag", "rotation_centre", "integration_rule", "sensor_delay",
          "sensor_bias", "slope", "relative_smoothing.own_motion", "sampling_interval.constant")  # fmt: skip


def test_derivatives_agree_with_finite_differences() -> None:
    """Along random directions in phi and K, with laws that act on commands, pushes and sensors."""
    rng = np.random.default_rng(0)
    constants = {k: v for key in SMOOTH for k, v in everywhere(key).items()}
    v = truth(constants)._replace(gain=rng.uniform(0.2, 0.8, 12).astype(np.float32))
    of = Problem(SPOT, SCALES, cut(nothing_planted(), 1 / 15), np.eye(12))
    free, _ = directions(of, ())
    columns, share = nuisance_columns(of, v), rng.normal(size=(3, len(free.phi))).astype(np.float32)
    share[:, :24] /= spans(of)
    h = 3e-3
    for tangent, along in zip(np.tensordot(share, columns, 1), share, strict=True):
        step = jax.tree.map(lambda b, along=along: h * np.tensordot(along, b, 1), free)
        ahead, back = trials(of, [jax.tree.map(np.add, v, step), jax.tree.map(np.subtract, v, step)])
        difference = (ahead - back) / (2 * h)
        size = np.sqrt((difference**2).mean(0))
        assert (size > 0).all()
        assert (np.sqrt(((tangent - difference) ** 2).mean(0)) < 0.02 * size + 1e-4).all()


@given(st.integers(1, 10**6))
def test_the_numbers_of_chunks_are_few_and_filled_up_by_little(count: int) -> None:
    full = filled(count)
    assert count <= full <= count + max(FEW - 1, count / SIZES)
    assert filled(full) == full
    assert len({filled(n) for n in range(count, 2 * count, max(count // 500, 1))}) <= 6


def test_recordings_of_like_length_compile_nothing_anew() -> None:
    some = nothing_planted()
    few, many = cut(some[:1], 1 / 15), cut(some, 1 / 15)
    alone_in_it = innovations(SPOT, SCALES, truth({}), few)
    compiled = filtered._cache_size()
    among = innovations(SPOT, SCALES, truth({}), many)
    assert filtered._cache_size() == compiled
    rows = np.asarray(few.counts)
    np.testing.assert_allclose(among[rows], alone_in_it[rows], atol=1e-6)


def test_chunks_are_made_of_their_fields() -> None:
    chunks = cut(nothing_planted(), 1 / 15)
    *arrays, table = chunks
    *again, without = as_chunks(list(zip(*map(np.asarray, arrays), strict=True)))
    for a, b in zip(arrays, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert table is None
    assert without is None


# The filter


@given(st.integers(0, 10**6), st.floats(-3, 3))
@settings(max_examples=10, deadline=None)
def test_the_filter_does_not_know_where_the_world_frame_lies(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    v = truth({})._replace(gain=rng.uniform(size=12), cross=0.3 * rng.normal(size=len(SPOT.layout.akin)))
    x, e = rng.normal(size=(2, 12))
    K = gain_matrix(SPOT, SCALES, v)
    c, s = np.cos(angle), np.sin(angle)

    def turned(a: np.ndarray) -> np.ndarray:
        """Positions and velocities along the world's x and y in another world frame."""
        a = a.copy()
        for i in (0, 3, 6, 9):
            a[[i, i + 1]] = c * a[i] - s * a[i + 1], s * a[i] + c * a[i + 1]
        return a

    there = turned(x) + angle * np.eye(12)[2]
    moved = np.asarray(corrected(SPOT.layout, K, jnp.asarray(there), jnp.asarray(turned(e)))) - there
    here = np.asarray(corrected(SPOT.layout, K, jnp.asarray(x), jnp.asarray(e))) - x
    np.testing.assert_allclose(moved, turned(here), atol=1e-3)


def test_entries_of_the_gain_are_in_units_of_the_time_step() -> None:
    v = truth({})._replace(gain=np.full(12, 0.5), cross=np.ones(len(SPOT.layout.akin)))
    K = np.asarray(gain_matrix(SPOT, SCALES, v))
    assert K[3, 0] == pytest.approx(15)  # base_vx by base_x: a metre off is a metre a time step too slow
    assert K[0, 3] == pytest.approx(1 / 15)
    assert K[9, 3] == K[6, 0] == 1  # the hand by the base
    np.testing.assert_allclose(np.diag(K), 0.5)
    assert K[8, 0] == 0


def test_of_a_step_taken_alone_with_other_constants_the_steps_before_it_know_nothing() -> None:
    chunks = cut(list(nothing_planted()), 1 / 15)
    bare, gained = truth({}), theta(acting("gain", (0.3,), (3,)))
    same = np.asarray(alone(SPOT, SCALES, bare, bare.theta, chunks))
    counts = np.asarray(chunks.counts)
    np.testing.assert_allclose(same[counts], np.asarray(innovations(SPOT, SCALES, bare, chunks))[counts], atol=1e-6)
    other = np.asarray(alone(SPOT, SCALES, bare, gained, chunks))
    own = other - same
    # Of a gain of the hand's speed, what a step adds is in proportion to the command of that row and no other.
    sent = np.abs(np.asarray(chunks.command)[:, :-1, 3])
    felt = np.linalg.norm(own[..., 9:11], axis=-1)
    np.testing.assert_allclose(felt, (1 - PHI[3]) * 0.3 * sent, atol=1e-5)
