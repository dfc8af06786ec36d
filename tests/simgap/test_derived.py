"""A velocity that is a difference of its position is known as one; a measured one never is, however exact."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import signal

from simgap.derived import Derived, derived, sentence
from simgap.types import Field, Recording, Schema

SCHEMA = Schema(
    state=(
        Field("place", "m", "position", "world", "cart", "x"),
        Field("speed", "m/s", "velocity", "world", "cart", "x"),
        Field("yaw", "rad", "angle", "world", "cart", "yaw"),
        Field("turning", "rad/s", "velocity", "world", "cart", "yaw"),
    ),
    command=(),
)
ROWS = 500
Motion = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Time stamps [s], positions, velocities."""


def recording(time: np.ndarray, place: np.ndarray, speed: np.ndarray) -> Recording:
    """The yaw is at rest but for noise, and its rate is measured."""
    noise = np.random.default_rng(9).normal(0, 0.01, (len(time), 2))
    return Recording("walk", time, np.column_stack([place, speed, noise]), np.zeros((len(time), 0)))


def kinds(*recordings: Recording) -> list[str]:
    return [d.kind for d in derived(SCHEMA, recordings)]


def waves(step: float, jitter: float = 0.0) -> Motion:
    time = np.cumsum(step * (1 + jitter * np.random.default_rng(1).uniform(-1, 1, ROWS)))
    return time, np.sin(2 * time) + 0.3 * np.sin(7 * time), 2 * np.cos(2 * time) + 2.1 * np.cos(7 * time)


def pushed(step: float, held: int, fine: int = 20) -> Motion:
    """A cart pushed by forces that are new every `held` rows, integrated in `fine` steps a row, by trapezoids."""
    forces = np.repeat(np.random.default_rng(2).normal(size=ROWS // held + 1), held * fine)[: ROWS * fine]
    place, speed, x, v = np.empty(ROWS), np.empty(ROWS), 0.0, 0.0
    for i, force in enumerate(forces):
        if i % fine == 0:
            place[i // fine], speed[i // fine] = x, v
        then = v + step / fine * (5 * force - v)
        x, v = x + step / fine * (v + then) / 2, then
    return np.arange(ROWS) * step, place, speed


def fall(step: float) -> Motion:
    time = np.arange(ROWS) * step
    return time, -9.81 / 2 * time**2, -9.81 * time


MOTIONS: dict[str, Callable[[float], Motion]] = {
    "waves": waves,
    "uneven waves": lambda step: waves(step, 0.3),
    "pushed": lambda step: pushed(step, 25),
    "pushed anew in every row": lambda step: pushed(step, 1),
    "fall": fall,
}
DIFFERENCES: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "forward": lambda p, t: np.append(np.diff(p) / np.diff(t), 0.0),
    "backward": lambda p, t: np.append(0.0, np.diff(p) / np.diff(t)),
    "central": np.gradient,
}
every_motion = pytest.mark.parametrize("motion", MOTIONS)
every_step = pytest.mark.parametrize("step", [0.002, 0.02, 0.1])


@every_motion
@every_step
@pytest.mark.parametrize("kind", DIFFERENCES)
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
def test_a_difference_is_known(motion: str, step: float, kind: str, noise: float) -> None:
    time, place, _ = MOTIONS[motion](step)
    place = place + np.random.default_rng(0).normal(0, noise, ROWS)
    speed = DIFFERENCES[kind](place, time)
    (found,) = derived(SCHEMA, [recording(time, place, speed)])
    assert found == Derived("speed", "place", kind)
    # As a table writes them.
    assert kinds(recording(np.round(time, 6), np.round(place, 6), np.round(speed, 6))) == [kind] or noise < step / 1000


@every_motion
@every_step
@pytest.mark.parametrize("place_noise", [0.0, 1e-4, 1e-2])
@pytest.mark.parametrize("speed_noise", [0.0, 1e-5, 1e-3, 0.05])
@pytest.mark.parametrize("digits", [3, 15])
def test_a_measured_velocity_is_none(
    motion: str, step: float, place_noise: float, speed_noise: float, digits: int
) -> None:
    """Not even one without noise, nor one of a position without noise, nor a coarse one."""
    time, place, speed = MOTIONS[motion](step)
    rng = np.random.default_rng(0)
    place, speed = place + rng.normal(0, place_noise, ROWS), speed + rng.normal(0, speed_noise, ROWS)
    assert not kinds(recording(time, np.round(place, digits), np.round(speed, digits)))


@pytest.mark.parametrize("fine", [2, 3, 5])
@pytest.mark.parametrize("held", [1, 25])
def test_a_simulation_of_several_steps_a_row_is_measured(fine: int, held: int) -> None:
    """Semi-implicit Euler, as physics engines integrate, every `fine`-th step of it recorded, without noise."""
    step, x, v, rows = 0.02, 0.0, 0.0, []
    for i, force in enumerate(np.repeat(np.random.default_rng(2).normal(size=ROWS // held), held * fine)):
        if i % fine == 0:
            rows.append((x, v))
        v += step / fine * (5 * force - v)
        x += step / fine * v
    states = np.array(rows)
    assert not kinds(recording(np.arange(len(states)) * step, *states.T))


def test_a_simulation_of_one_step_a_row_is_a_difference() -> None:
    """Its velocity is the backward difference of its position exactly, as one that was computed from it."""
    x, v, rows = 0.0, 0.0, []
    for force in np.random.default_rng(2).normal(size=ROWS):
        rows.append((x, v))
        v += 0.02 * (5 * force - v)
        x += 0.02 * v
    time, states = np.arange(ROWS) * 0.02, np.array(rows)
    assert kinds(recording(time, *states.T)) == ["backward"]
    # With the sensors' noise on both it is a measurement.
    noisy = states + np.random.default_rng(0).normal(0, (1e-3, 1e-2), states.shape)
    assert not kinds(recording(time, *noisy.T))


FILTERS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "first order": lambda rate: signal.lfilter([0.3], [1, -0.7], rate),
    "second order": lambda rate: signal.lfilter(*signal.butter(2, 0.3), rate),
    "mean of five": lambda rate: np.convolve(rate, np.ones(5) / 5, "same"),
    "Savitzky-Golay": lambda rate: signal.savgol_filter(rate, 7, 2),
}


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("motion", ["waves", "pushed"])
def test_a_filtered_difference_of_a_noisy_position_is_known(name: str, motion: str) -> None:
    time, place, _ = MOTIONS[motion](0.02)
    place = place + np.random.default_rng(0).normal(0, 3e-3, ROWS)
    assert kinds(recording(time, place, FILTERS[name](DIFFERENCES["backward"](place, time)))) == ["filtered"]


def test_a_filtered_measurement_of_the_velocity_is_none() -> None:
    time, place, speed = waves(0.02)
    rng = np.random.default_rng(0)
    for name, smooth in FILTERS.items():
        measured = smooth(speed + rng.normal(0, 0.05, ROWS))
        assert not kinds(recording(time, place + rng.normal(0, 3e-3, ROWS), measured)), name


def test_an_angle_is_differenced_the_short_way_round() -> None:
    time = np.arange(ROWS) * 0.02
    yaw = (3 * time + 0.2 * np.sin(5 * time) + np.random.default_rng(0).normal(0, 1e-3, ROWS) + np.pi) % (2 * np.pi)
    yaw -= np.pi
    state = np.zeros((ROWS, 4))
    state[:, 2] = yaw
    state[1:, 3] = ((np.diff(yaw) + np.pi) % (2 * np.pi) - np.pi) / 0.02
    (found,) = derived(SCHEMA, [Recording("walk", time, state, np.zeros((ROWS, 0)))])
    assert found == Derived("turning", "yaw", "backward")


CAR = Schema(
    state=(
        Field("x", "m", "position", "world", "car", "x"),
        Field("y", "m", "position", "world", "car", "y"),
        Field("yaw", "rad", "angle", "world", "car", "yaw"),
        Field("ahead", "m/s", "velocity", "body", "car", "x"),
        Field("aside", "m/s", "velocity", "body", "car", "y"),
    ),
    command=(),
)


def driven(speeds: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray], noise: float) -> Recording:
    """A car that turns and slips; `speeds` gives its velocities in the world of x, y and times."""
    time = np.arange(ROWS) * 0.02
    yaw = 0.8 * time + 0.5 * np.sin(1.3 * time)
    x, y = np.sin(0.9 * time) + 0.3 * np.sin(4 * time), np.cos(0.7 * time) + 0.2 * np.sin(5 * time)
    x, y = np.column_stack([x, y]).T + np.random.default_rng(0).normal(0, noise, (2, ROWS))
    (vx, vy), c, s = speeds(x, y, time), np.cos(yaw), np.sin(yaw)
    wrapped = (yaw + np.pi) % (2 * np.pi) - np.pi
    state = np.column_stack([x, y, wrapped, c * vx + s * vy, c * vy - s * vx])
    return Recording("drive", time, state, np.zeros((ROWS, 0)))


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
@pytest.mark.parametrize("kind", DIFFERENCES)
def test_a_difference_that_is_turned_into_the_bodys_frame_is_known(kind: str, noise: float) -> None:
    difference = DIFFERENCES[kind]
    found = derived(CAR, [driven(lambda x, y, t: np.array([difference(x, t), difference(y, t)]), noise)])
    assert found == [Derived("ahead", "x and y", kind), Derived("aside", "x and y", kind)]


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
def test_a_velocity_measured_in_the_bodys_frame_is_none(noise: float) -> None:
    def exact(_x: np.ndarray, _y: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.array([0.9 * np.cos(0.9 * t) + 1.2 * np.cos(4 * t), -0.7 * np.sin(0.7 * t) + np.cos(5 * t)])

    assert not derived(CAR, [driven(exact, noise)])


def test_a_pause_does_not_make_a_measurement_a_difference() -> None:
    time, place, speed = waves(0.02)
    rng = np.random.default_rng(0)
    place, speed = place + rng.normal(0, 1e-3, ROWS), speed + rng.normal(0, 0.02, ROWS)
    assert not kinds(recording(time + 60.0 * (time > 5), place, speed))
    assert kinds(recording(time + 60.0 * (time > 5), place, np.gradient(place, time))) == ["central"]


def test_a_difference_by_the_nominal_rate_is_known() -> None:
    time, place, _ = waves(0.02, 0.3)
    assert kinds(recording(time, place, np.append(0.0, np.diff(place)) * 50)) != []


def test_too_few_rows_and_rows_at_rest_are_no_difference() -> None:
    time, place, _ = waves(0.02)
    speed = DIFFERENCES["backward"](place, time)
    assert not kinds(recording(time[:15], place[:15], speed[:15]))
    assert not kinds(recording(time, np.zeros(ROWS), np.zeros(ROWS)))
    halves = [recording(time[s], place[s], speed[s]) for s in (slice(0, 15), slice(15, 30))]
    assert kinds(*halves) == ["backward"]


@pytest.mark.parametrize("kind", ["forward", "backward", "central", "filtered"])
def test_the_sentence_has_the_columns_and_what_to_do(kind: str) -> None:
    said = sentence(Derived("speed", "place", kind))
    assert said.startswith("speed is ")
    assert f"{kind} difference of place" in said
    assert "Record the velocity that a sensor gives" in said
