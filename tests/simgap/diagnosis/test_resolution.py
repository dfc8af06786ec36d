"""Readings that come in steps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simgap.diagnosis.likelihood.resolution import dithered, resolution
from simgap.diagnosis.likelihood.student_t import fit_noise
from simgap.types import Recording, Sessions

ROWS = 400


def recording(*columns: np.ndarray) -> Recording:
    state = np.column_stack(columns)
    return Recording("a", np.arange(len(state)) / 50, state, np.zeros((len(state), 1)))


def motion(seed: int = 0, still: int = ROWS // 2) -> np.ndarray:
    """Rest, then a smooth motion."""
    t = np.maximum(np.arange(ROWS) - still, 0) / 50
    return np.random.default_rng(seed).uniform(0.5, 1.5) * (1 - np.cos(2 * t))


@given(st.integers(0, 2**32 - 1), st.floats(1e-4, 0.01), st.floats(-3, 3))
def test_the_step_of_an_encoder_is_found(seed: int, step: float, offset: float) -> None:
    read = offset + step * np.round(motion(seed) / step)
    assert resolution([recording(read)]) == pytest.approx([step], rel=1e-3)


@given(st.integers(0, 2**32 - 1))
def test_what_does_not_come_in_steps_has_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noisy, exact = motion(seed) + 1e-3 * rng.normal(size=ROWS), motion(seed)
    steady = np.maximum(np.arange(ROWS) - 100, 0) * 0.01  # rest, and one speed without noise
    assert not resolution([recording(noisy, exact, np.zeros(ROWS), steady)]).any()


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 100.0))
def test_rounding_in_32_bits_is_no_step(seed: int, size: float) -> None:
    read = size * (1 + 3e-7 * np.random.default_rng(seed).normal(size=ROWS))
    assert not resolution([recording(read.astype(np.float32))]).any()


def test_rows_at_rest_have_the_noise_of_a_step_and_others_are_as_they_were() -> None:
    """Without it the noise at rest is zero, and a model that never moves is infinitely likely."""
    step, rng = 0.01, np.random.default_rng(0)
    noisy = motion() + 1e-3 * rng.normal(size=ROWS)
    recorded = recording(step * np.round(motion() / step), noisy)
    steps = resolution([recorded])
    ((after,), *_) = dithered(Sessions([recorded], []), steps, rng)
    np.testing.assert_array_equal(after.state[:, 1], noisy)
    assert np.abs(after.state[:, 0] - recorded.state[:, 0]).max() <= step / 2
    assert (np.round(after.state[:, 0] / step) == np.round(recorded.state[:, 0] / step)).all()
    at_rest = np.diff(after.state[: ROWS // 2, :1], axis=0)
    assert fit_noise(at_rest).scale == pytest.approx([step / np.sqrt(6)], rel=0.3)


def test_without_steps_the_sessions_are_the_same() -> None:
    sessions = Sessions([recording(motion() + 1e-3 * np.random.default_rng(0).normal(size=ROWS))], [])
    assert dithered(sessions, resolution(sessions.training), np.random.default_rng(0)) is sessions
