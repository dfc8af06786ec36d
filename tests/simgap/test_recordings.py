"""Sessions to rows: nothing crosses sessions, history is the past, bad input is named."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simgap.recordings import (
    HISTORY,
    check_recording,
    decode_state,
    divide,
    draw,
    encode_state,
    normalisation,
    to_transitions,
)
from simgap.simulators.spot import SCHEMA
from simgap.types import Recording, RecordingError


def columns(rows: int = 10) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    table = {c: rng.uniform(-1, 1, rows) for c in SCHEMA.columns}
    table["time_s"] = np.arange(rows) / 15
    return table


def session(name: str, rows: int, offset: float) -> Recording:
    """Every command row is its own row number, so that a row's history can be read off."""
    t = np.arange(rows)
    state = np.zeros((rows, 12))
    state[:, 0] = offset + t
    return Recording(name, t / 15, state, np.tile((offset + t)[:, None], (1, 6)))


@given(st.lists(st.floats(-10, 10), min_size=12, max_size=12), st.floats(-np.pi + 1e-3, np.pi - 1e-3))
@settings(max_examples=30, deadline=None)
def test_encoding_inverts(values: list[float], yaw: float) -> None:
    state = np.array(values)
    state[2] = yaw
    encoded = encode_state(SCHEMA, jnp.asarray(state))
    assert encoded.shape == (13,) == (len(SCHEMA.encoded),)
    np.testing.assert_allclose(decode_state(SCHEMA, encoded), state, atol=1e-5)


def test_transitions_hold_the_past_and_stay_inside_sessions() -> None:
    rows = to_transitions(SCHEMA, [session("a", 6, 0.0), session("b", 5, 100.0)])
    assert rows.x.shape == (3 + 2, 31)
    assert rows.y.shape == (5, 13)
    np.testing.assert_array_equal(rows.x[:, 0], [2, 3, 4, 102, 103])  # s_t
    np.testing.assert_array_equal(rows.x[:, 13], [0, 1, 2, 100, 101])  # u_{t-2}
    np.testing.assert_array_equal(rows.x[:, 19], [1, 2, 3, 101, 102])  # u_{t-1}
    np.testing.assert_array_equal(rows.x[:, 25], [2, 3, 4, 102, 103])  # u_t
    np.testing.assert_array_equal(rows.y[:, 0], 1.0)
    np.testing.assert_array_equal(rows.session, [0, 0, 0, 1, 1])


@given(st.integers(0, 1000), st.integers(1, 50))
@settings(max_examples=20, deadline=None)
def test_draw_has_no_repetition(seed: int, count: int) -> None:
    rows = np.asarray(draw(jax.random.key(seed), count, 50))
    assert len(set(rows.tolist())) == count
    assert rows.min() >= 0
    assert rows.max() < 50


def test_a_constant_column_gets_unit_scale() -> None:
    stats = normalisation(jnp.ones((5, 2)), jnp.arange(10.0).reshape(5, 2))
    np.testing.assert_array_equal(stats.x_std, 1.0)


def test_good_columns_pass() -> None:
    assert check_recording(SCHEMA, "a.csv", columns()).state.shape == (10, 12)


def _without(name: str) -> dict[str, np.ndarray]:
    return {k: v for k, v in columns().items() if k != name}


def _with(name: str, row: int, value: float) -> dict[str, np.ndarray]:
    table = columns()
    table[name][row] = value
    return table


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (_without("ee_z"), ["a.csv", "ee_z", "missing"]),
        (_with("base_vx", 3, np.nan), ["a.csv", "base_vx", "row 4", "finite"]),
        (_with("cmd_ee_vx", 9, np.inf), ["a.csv", "cmd_ee_vx", "row 10", "finite"]),
        (_with("time_s", 5, 0.1), ["a.csv", "time_s", "row 6", "increase"]),
        (_with("base_yaw", 2, 90.0), ["a.csv", "base_yaw", "row 3", "rad"]),
        (columns(3), ["a.csv", "3 rows", "at least 4"]),
    ],
)
def test_bad_columns_are_named(table: dict[str, np.ndarray], words: list[str]) -> None:
    with pytest.raises(RecordingError) as error:
        check_recording(SCHEMA, "a.csv", table)
    assert all(word in str(error.value) for word in words)


@given(st.lists(st.integers(4, 30), min_size=1, max_size=5), st.integers(0, 150))
@settings(max_examples=60, deadline=None)
def test_sessions_are_divided_at_a_number_of_transitions(rows: list[int], count: int) -> None:
    """The first part has exactly that many, and no row is in both."""
    given = [session(f"{i}", n, 1000.0 * i) for i, n in enumerate(rows)]
    first, rest = divide(given, count)

    def transitions(parts: list[Recording]) -> int:
        assert all(len(r.time_s) == len(r.state) == len(r.command) >= HISTORY + 2 for r in parts)
        return sum(len(r.time_s) - 1 - HISTORY for r in parts)

    whole = transitions(given)
    assert transitions(first) == min(count, whole)
    # The cut costs the rest a history and, where less than a transition is left, that.
    assert max(whole - count - HISTORY - 1, 0) <= transitions(rest) <= max(whole - count, 0)
    places = [float(x) for r in (*first, *rest) for x in r.state[:, 0]]
    assert places == sorted(set(places))
    names = [r.name for r in (*first, *rest)]
    assert len(names) == len(set(names))
    assert all("rows" in n or len(r.time_s) == rows[int(n)] for n, r in zip(names, (*first, *rest), strict=True))
