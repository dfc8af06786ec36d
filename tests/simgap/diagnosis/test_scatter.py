"""Scatter that is planted is told, stepping with its frequency; where none is, none is told."""

import jax.numpy as jnp
import numpy as np
import pytest
from planted import PHI, SENSOR
from small import RICH, problem, sessions

from simgap.diagnosis.fit import evaluate, start, whitening
from simgap.diagnosis.innovations import cut
from simgap.diagnosis.scatter import OWED, SEGMENT, Scatter, scatter
from simgap.simulators.spot import SCHEMA
from simgap.types import Recording

AMPLITUDE, RATE = 0.05, 15.0
"""Of the shaking [m/s], of the rows [Hz]."""


def shaken(recordings: list[Recording], output: int, hertz: float) -> list[Recording]:
    """Sessions in which a velocity oscillates besides, with another phase in each."""
    out = []
    for phase, r in enumerate(recordings):
        state = r.state.copy()
        amplitude = AMPLITUDE if SCHEMA.state[output].kind == "velocity" else AMPLITUDE / (2 * np.pi * hertz)
        state[:, output] += amplitude * np.sin(2 * np.pi * hertz * r.time_s + phase)
        out.append(r._replace(state=state))
    return out


def told(training: list[Recording], heldout: list[Recording]) -> list[Scatter]:
    """What is told under the true simulator, by which nothing else is missing."""
    bare = problem(training)
    v = start(bare)._replace(phi=jnp.asarray(PHI))
    of = bare._replace(whiten=whitening(evaluate(bare, v, ()).e))
    return scatter(of, evaluate(of, v, ()), cut(heldout, 1 / RATE, least=len(of.chunks.row)))


def stepping(training: list[Recording], heldout: list[Recording]) -> list[Scatter]:
    """What is told of it, whatever else is."""
    return [s for s in told(training, heldout) if s.id == "gait_oscillation"]


@pytest.mark.parametrize(
    ("output", "name", "hertz"),
    [(4, "base_vy", 1.8), (11, "ee_vz", 1.8), (4, "base_vy", 3.1), (8, "ee_z", 1.2)],
)
def test_planted_stepping_is_told_with_its_frequency(output: int, name: str, hertz: float) -> None:
    (found,) = stepping(*(shaken(s, output, hertz) for s in sessions({})))
    amplitude, frequency = found.constants
    assert found.outputs == (name,)
    assert abs(frequency["value"] - hertz) < RATE / SEGMENT  # a bin
    assert amplitude["ci95"][0] < AMPLITUDE < amplitude["ci95"][1]
    assert found.gain > 5 * OWED
    assert found.heldout_gain > OWED


@pytest.mark.parametrize("seed", range(3))
def test_where_nothing_shakes_no_stepping_is_told(seed: int) -> None:
    assert not stepping(*sessions({}, seed))


@pytest.mark.parametrize("seed", [11, 12])
def test_noise_of_the_sensors_is_not_taken_for_scatter_that_grows_with_the_motion(seed: int) -> None:
    """What a noisy sensor says of the motion of a row holds the row's own noise."""
    assert not told(*sessions({}, seed, noise=16.0))


def test_scatter_that_grows_with_the_motion_is_told() -> None:
    rng = np.random.default_rng(0)

    def noisy(r: Recording) -> Recording:
        speed = np.abs(r.state[:, [3, 4, 5, 9, 10, 11]]).mean(1, keepdims=True)
        return r._replace(state=r.state + 3 * speed * SENSOR * rng.normal(size=r.state.shape))

    (found,) = told(*([noisy(r) for r in part] for part in sessions({}, RICH)))
    assert found.id == "motion_dependent_noise"
    assert found.heldout_gain > 0
