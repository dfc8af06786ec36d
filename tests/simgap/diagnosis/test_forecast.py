"""What a black box adds enters forecasts, not the filter that they begin with, and is what it was trained to add."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import PHI
from small import problem, sessions

from simgap.diagnosis.likelihood.problem import start
from simgap.diagnosis.likelihood.segments import RUN_IN
from simgap.diagnosis.report import figures
from simgap.diagnosis.validation import black_box
from simgap.diagnosis.validation.forecast import Contestant, forecast, window, windows
from simgap.types import Recording

ROWS = 120
HEIGHT = 8
"""Of the hand, which no frame turns."""


def session(starts: list[int]) -> Recording:
    """A long session of two commands, one of which is large for five rows from each start."""
    command = np.full((ROWS, 2), 0.1)
    for first in starts:
        command[first : first + 5, 1] = 1.0
    time_s = np.cumsum(np.linspace(0.05, 0.1, ROWS))
    return Recording("one", time_s, np.arange(ROWS * 3.0).reshape(ROWS, 3), command)


@given(st.integers(1, 60), st.integers(0, 30))
@settings(max_examples=20, deadline=None)
def test_a_single_window_is_one_of_those_at_every_row(horizon: int, first: int) -> None:
    recording = session([50])
    every = windows([recording], 1 / 15, horizon, 1)
    assert every is not None
    for found, expected in zip(window(recording, 1 / 15, horizon, first), every, strict=True):
        if expected is not None:
            np.testing.assert_array_equal(np.asarray(found)[0], np.asarray(expected)[first])


@given(st.lists(st.integers(0, ROWS - 5), max_size=6), st.integers(2, 60))
@settings(max_examples=40, deadline=None)
def test_the_busiest_window_has_the_most_commands(starts: list[int], steps: int) -> None:
    recording = session(starts)
    found = figures.activity(recording, steps)
    size = recording.command[:, 0] / 0.1 + recording.command[:, 1] / recording.command[:, 1].max()
    expected = [size[r + RUN_IN : r + RUN_IN + steps].sum() for r in range(ROWS - RUN_IN - steps)]
    np.testing.assert_allclose(found, expected)


def test_a_black_box_adds_to_what_is_foretold_from_the_filters_own_estimate() -> None:
    training, _ = sessions({})
    of = problem(training)
    v = start(of)._replace(phi=jnp.asarray(PHI))
    pieces = windows(training, 1 / 15, 3, 20)
    assert pieces is not None
    silent = black_box.silent(of.augmented.layout)
    lifting = silent._replace(weights=silent.weights.at[0, HEIGHT].set(0.01))
    without, with_it = (forecast(of, Contestant(v, box), pieces) for box in (silent, lifting))
    added = with_it - without
    np.testing.assert_allclose(added[:, :, HEIGHT], np.tile([0.01, 0.02, 0.03], (len(added), 1)), atol=1e-5)
    np.testing.assert_allclose(np.delete(added, HEIGHT, axis=2), 0, atol=1e-5)


def test_a_black_box_says_of_an_innovation_what_it_adds_to_the_forecast_of_that_row() -> None:
    """It is trained on what it sees in forecasts: not on measured states, whose noise foretells innovations too."""
    training, _ = sessions({}, noise=3.0)
    of = problem(training)
    v = start(of)._replace(phi=jnp.asarray(PHI))
    box = black_box.train(of, v, np.random.default_rng(0))
    pieces = windows(training, 1 / 15, 1, 10**6)  # the first rows of each session, with which its first chunk begins
    assert pieces is not None
    silent = black_box.silent(of.augmented.layout)
    without, with_it = (forecast(of, Contestant(v, b), pieces)[:, 0] for b in (silent, box))
    firsts = np.unique(of.chunks.session, return_index=True)[1]
    said = black_box.predicted(of, v, box)[firsts, RUN_IN]
    assert np.abs(said).max() > 1e-3
    np.testing.assert_allclose(with_it - without, said, atol=1e-5)
