"""Stepping that is planted in a velocity is told with its frequency; where none is, none is told."""

import jax.numpy as jnp
import numpy as np
import pytest
from planted import PHI
from small import problem, sessions

from simgap.diagnosis.fit import evaluate, start, whitening
from simgap.diagnosis.innovations import cut
from simgap.diagnosis.scatter import SEGMENT, Scatter, scatter
from simgap.types import Recording

AMPLITUDE, RATE = 0.05, 15.0
"""Of the shaking [m/s], of the rows [Hz]."""


def shaken(recordings: list[Recording], output: int, hertz: float) -> list[Recording]:
    """Sessions in which a velocity oscillates besides, with another phase in each."""
    out = []
    for phase, r in enumerate(recordings):
        state = r.state.copy()
        state[:, output] += AMPLITUDE * np.sin(2 * np.pi * hertz * r.time_s + phase)
        out.append(r._replace(state=state))
    return out


def stepping(training: list[Recording], heldout: list[Recording]) -> list[Scatter]:
    """What is told of it under the true simulator, by which nothing else is missing."""
    bare = problem(training)
    v = start(bare)._replace(phi=jnp.asarray(PHI))
    of = bare._replace(whiten=whitening(evaluate(bare, v, ()).e))
    unseen = cut(heldout, 1 / RATE, least=len(of.chunks.row))
    return [s for s in scatter(of, evaluate(of, v, ()), unseen) if s.id == "gait_oscillation"]


@pytest.mark.parametrize(("output", "name", "hertz"), [(4, "base_vy", 1.8), (11, "ee_vz", 1.8), (4, "base_vy", 3.1)])
def test_planted_stepping_is_told_with_its_frequency(output: int, name: str, hertz: float) -> None:
    (found,) = stepping(*(shaken(s, output, hertz) for s in sessions({})))
    amplitude, frequency = found.constants
    assert found.outputs == (name,)
    assert abs(frequency["value"] - hertz) < RATE / SEGMENT  # a bin
    assert amplitude["ci95"][0] < AMPLITUDE < amplitude["ci95"][1]
    assert found.gain > 100
    assert found.heldout_gain > 10


@pytest.mark.parametrize("seed", range(3))
def test_where_nothing_shakes_no_stepping_is_told(seed: int) -> None:
    assert not stepping(*sessions({}, seed))
