"""Planted effects on the noise are found, stepping with its frequency; where none is planted, none is found."""

import jax.numpy as jnp
import numpy as np
import pytest
from planted import PHI, SENSOR
from small import RICH, problem, sessions

from simgap.diagnosis.inference.noise.effect import NoiseEffect
from simgap.diagnosis.inference.noise.find import noise_effects
from simgap.diagnosis.inference.noise.spectral_line import SEGMENT
from simgap.diagnosis.likelihood.problem import evaluate, start, whitening
from simgap.diagnosis.likelihood.segments import cut
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


def noise_effects_in(
    training: list[Recording], heldout: list[Recording], before: list[Recording] | None = None
) -> list[NoiseEffect]:
    """Effects on the noise under the true simulator, which lacks nothing else; not those of a baseline as well."""
    bare = problem(training)
    v = start(bare)._replace(phi=jnp.asarray(PHI))
    of = bare._replace(whiten=whitening(evaluate(bare, v, ()).e))
    rows = lambda sessions: cut(sessions, 1 / RATE, least=len(of.chunks.row))  # noqa: E731
    return noise_effects(of, evaluate(of, v, ()), rows(heldout), rows(before) if before else None)


def stepping(*sets: list[Recording]) -> list[NoiseEffect]:
    """The oscillations found, whatever else is."""
    return [s for s in noise_effects_in(*sets) if s.id == "gait_oscillation"]


@pytest.mark.parametrize(
    ("output", "name", "hertz"),
    [(4, "base_vy", 1.8), (11, "ee_vz", 1.8), (4, "base_vy", 3.1), (8, "ee_z", 1.2)],
)
def test_planted_stepping_is_told_with_its_frequency(output: int, name: str, hertz: float) -> None:
    (found,) = stepping(*(shaken(s, output, hertz) for s in sessions({})))
    amplitude, frequency = found.constants
    assert found.outputs == (name,)
    assert abs(frequency["value"] - hertz) < RATE / SEGMENT  # a bin
    assert amplitude["value"] == pytest.approx(AMPLITUDE, rel=0.15)
    assert found.gain > 100
    assert found.heldout_gain > 10


@pytest.mark.long
def test_weak_stepping_is_told_where_it_lasts() -> None:
    """In a third of the amplitude, eight sessions to fit and as many held out."""
    still = [r for seed in range(4) for part in sessions({}, seed) for r in part]
    weak = [r._replace(state=r.state + 0.3 * (s.state - r.state))
            for r, s in zip(still, shaken(still, 4, 1.8), strict=True)]  # fmt: skip
    (found,) = stepping(weak[::2], weak[1::2])
    assert found.outputs == ("base_vy",)
    assert 0.3 * found.gain < found.heldout_gain < 3 * found.gain


@pytest.mark.parametrize(("was", "hertz", "new"), [(1.0, 1.8, False), (1.0, 3.1, False), (0.4, 1.8, True)])
def test_stepping_is_new_where_it_is_stronger_than_it_was(was: float, hertz: float, new: bool) -> None:
    """A robot's steps are as fast as it walks."""
    after = [shaken(s, 4, 1.8) for s in sessions({})]
    before, _ = sessions({}, RICH)
    shaking = [r._replace(state=r.state + was * (s.state - r.state)) for r, s in
               zip(before, shaken(before, 4, hertz), strict=True)]  # fmt: skip
    assert bool(stepping(*after, shaking)) == new


@pytest.mark.parametrize("seed", range(3))
def test_where_nothing_shakes_no_stepping_is_told(seed: int) -> None:
    assert not stepping(*sessions({}, seed))


@pytest.mark.parametrize("seed", [11, 12])
def test_noise_of_the_sensors_is_not_taken_for_scatter_that_grows_with_the_motion(seed: int) -> None:
    """What a noisy sensor says of the motion of a row holds the row's own noise."""
    assert not noise_effects_in(*sessions({}, seed, noise=16.0))


def test_scatter_that_grows_with_the_motion_is_told() -> None:
    rng = np.random.default_rng(0)

    def noisy(r: Recording) -> Recording:
        speed = np.abs(r.state[:, [3, 4, 5, 9, 10, 11]]).mean(1, keepdims=True)
        return r._replace(state=r.state + 3 * speed * SENSOR * rng.normal(size=r.state.shape))

    (found,) = noise_effects_in(*([noisy(r) for r in part] for part in sessions({}, RICH)))
    assert found.id == "motion_dependent_noise"
    assert found.heldout_gain > 0


def test_of_scatter_that_grows_with_one_bodys_motion_that_body_is_told() -> None:
    rng, own = np.random.default_rng(0), np.arange(6)

    def noisy(r: Recording) -> Recording:
        state = r.state.copy()
        speed = np.abs(r.state[:, 3:6]).mean(1, keepdims=True)
        state[:, own] += 3 * speed * SENSOR[own] * rng.normal(size=(len(state), len(own)))
        return r._replace(state=state)

    (found,) = noise_effects_in(*([noisy(r) for r in part] for part in sessions({}, RICH)))
    assert found.id == "motion_dependent_noise"
    assert found.outputs == tuple(f.name for f in SCHEMA.state[:6])


JITTER = 0.25
"""Standard deviation of the rows' intervals, in nominal ones."""


def uneven(r: Recording, seed: int) -> Recording:
    """The session read off at uneven times, and stamped as if they were even."""
    rng = np.random.default_rng(seed)
    intervals = np.maximum(1 + JITTER * rng.normal(size=len(r.time_s)), 0.2) / RATE
    time_s = r.time_s[0] + np.cumsum(intervals)
    time_s = time_s[time_s < r.time_s[-1]]
    moved = r.state.copy()
    moved[:, 2] = np.unwrap(moved[:, 2])
    state = np.column_stack([np.interp(time_s, r.time_s, y) for y in moved.T])
    state[:, 2] = np.arctan2(np.sin(state[:, 2]), np.cos(state[:, 2]))
    command = r.command[np.searchsorted(r.time_s, time_s, side="right") - 1]
    return Recording(r.name, np.arange(len(time_s)) / RATE, state, command)


def test_rows_that_span_uneven_times_are_told() -> None:
    training, heldout = sessions({}, RICH)
    (found,) = noise_effects_in([uneven(r, k) for k, r in enumerate(training)], [uneven(r, 9) for r in heldout])
    (jitter,) = found.constants
    assert found.id == "sampling_interval"
    assert jitter["value"] == pytest.approx(JITTER / RATE, rel=0.3)
    assert found.heldout_gain > 0


@pytest.mark.parametrize(("channels", "body"), [(range(6), ""), (range(3), "base"), (range(3, 6), "ee")])
def test_of_commands_that_are_lost_those_are_told_that_are(channels: range, body: str) -> None:
    share = np.zeros(6)
    share[list(channels)] = 0.08
    (found,) = noise_effects_in(*sessions({}, RICH, lost=share))
    assert found.id == "dropout"
    assert set(found.outputs) == {f.name for f in SCHEMA.state if f.body == body or not body}
    assert found.gain > 30
    assert found.odds["dropout"] == max(found.odds.values())
    assert found.odds["dropout"] < 1 - 1e-6  # of a dozen bursts
