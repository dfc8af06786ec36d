"""First guesses of unmeasured velocities, and segments that begin with what was measured before them."""

from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Array, Float

from simgap.diagnosis.likelihood.problem import Problem, start
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.unmeasured import continued, guessed
from simgap.effects.augmented import Augmented
from simgap.types import Field, Parameter, Recording, Schema, Sessions

STEP, NOISE, SPEED = 0.1, 0.01, 0.3


class Puck:
    """It glides: nothing ends what it does. Only where it is is measured."""

    schema = Schema(
        (Field("x", "m", "position", "world", "puck", "x"),
         Field("v", "m/s", "velocity", "world", "puck", "x", observed=False)),
        (Field("push", "m/s^2", "force", "world", "puck", "x"),),
    )  # fmt: skip
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    time_step = STEP

    def step(self, _: Float[Array, " p"], state: Float[Array, " s"], command: Float[Array, " u"]) -> Float[Array, " s"]:
        return state + STEP * (state[::-1] * np.array([1, 0]) + command * np.array([0, 1]))


def alone(*recordings: Recording) -> Sessions:
    return Sessions(recordings, ())


@given(st.integers(1, 12), st.integers(0, 2**31 - 1))
@settings(max_examples=30)
def test_the_velocity_of_a_parabola_is_guessed_at_every_row(rows: int, seed: int) -> None:
    """Also at both ends, and where rows are unevenly spaced. One row has no slope, two have that of a line."""
    rng = np.random.default_rng(seed)
    time, (a, b, c) = np.cumsum(rng.uniform(0.05, 0.2, rows)), rng.normal(size=3)
    x = a + b * time + (c * time**2 if rows > 2 else 0.0)
    (found,) = guessed(Puck(), alone(Recording("a", time, x[:, None], np.zeros((rows, 1))))).training
    expected = np.zeros(rows) if rows == 1 else b + (2 * c * time if rows > 2 else 0.0)
    np.testing.assert_allclose(found.state[:, 1], expected, atol=1e-6)


@pytest.mark.parametrize("seed", [0, 1])
def test_segments_begin_with_what_the_rows_before_them_say(seed: int) -> None:
    rng, rows = np.random.default_rng(seed), 1000
    time = STEP * np.arange(rows)
    true = np.stack([SPEED * time, np.full(rows, SPEED)], 1)
    measured = Recording("a", time, true[:, :1] + NOISE * rng.normal(size=(rows, 1)), np.zeros((rows, 1)))
    sessions = guessed(Puck(), alone(measured))
    augmented, chunks = Augmented(Puck()), cut(sessions.fitted, STEP)
    problem = Problem(augmented, measure(augmented, sessions.fitted), chunks, np.eye(1))
    # The gain of an alpha-beta filter that averages over some twenty rows; no speed is measured.
    v = start(problem)._replace(gain=np.array([0.2, 0.5], np.float32), cross=np.array([0.0, 0.02], np.float32))
    assert augmented.layout.akin == ((0, 1), (1, 0))
    begun = continued(problem, v, chunks)
    np.testing.assert_array_equal(begun.state[:, 1:], chunks.state[:, 1:])
    np.testing.assert_array_equal(begun.state[chunks.row == 0], chunks.state[chunks.row == 0])
    later = np.flatnonzero(chunks.row)
    assert len(later) > 20
    error = lambda segments: np.sqrt(np.mean((np.asarray(segments.state)[later, 0] - true[chunks.row[later]]) ** 2, 0))  # noqa: E731
    assert error(begun)[0] < 0.6 * error(chunks)[0]
    assert error(begun)[1] < 0.6 * error(chunks)[1]
