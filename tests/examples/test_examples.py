"""The examples: steps by hand, recordings that hold what they claim, and a page whose code works."""

import math
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import nbformat
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nbclient import NotebookClient

from examples.car import CAR, Car
from examples.drive import DRIVE, Drive
from examples.knockouts import WITHOUT_INDUCED_VELOCITY, late
from examples.record import MACHINES, CarConfig, DriveConfig, car_session, drive_session, main, record
from simgap.formats.recordings import read_recordings, write_recording
from simgap.loading.checks import check
from simgap.loading.load import load
from simgap.simulators.spot import SCHEMA, Spot
from simgap.types import Recording

ROOT = Path(__file__).parents[2]
QUIET_DRIVE = DriveConfig(position_noise=0.0, velocity_noise=0.0)
QUIET_CAR = CarConfig(position_noise=0.0, yaw_noise=0.0, speed_noise=0.0)
quick = settings(max_examples=20, deadline=None)


@pytest.mark.parametrize(
    ("spec", "kind"), [("examples.drive:DRIVE", Drive), ("examples.drive:Drive", Drive), ("examples.car:CAR", Car)]
)
def test_examples_load(spec: str, kind: type) -> None:
    assert isinstance(load(spec), kind)


# The simulators


@pytest.mark.parametrize(
    ("params", "state", "command", "expected"),
    [
        ((2.0, 0.0), (0.0, 0.0), 10.0, (0.001, 0.1)),  # a = 5 m/s^2: v = 5 0.02, p = 5 0.02^2 / 2
        ((2.0, 4.0), (1.0, 1.0), 0.0, (1 + 0.02 * (1 + 0.98 / 1.02) / 2, 0.98 / 1.02)),  # k = 0.02
        ((2.0, 4.0), (0.0, 0.5), 2.0, (0.01, 0.5)),  # the force holds the speed: F = d v
    ],
)
def test_drive_by_hand(params: tuple, state: tuple, command: float, expected: tuple) -> None:
    got = DRIVE.step(jnp.array(params), jnp.array(state), jnp.array([command]))
    np.testing.assert_allclose(got, expected, rtol=1e-6)


@given(mass=st.floats(0.5, 8), damping=st.floats(0.1, 20), force=st.floats(-15, 15), speed=st.floats(-2, 2))
@quick
def test_drive_follows_its_equation(mass: float, damping: float, force: float, speed: float) -> None:
    """m v' = F - d v, solved exactly."""
    final, decay = force / damping, math.exp(-damping * DRIVE.time_step / mass)
    v = final + (speed - final) * decay
    p = final * DRIVE.time_step + (speed - final) * (1 - decay) * mass / damping
    got = DRIVE.step(jnp.array([mass, damping]), jnp.array([0.0, speed]), jnp.array([force]))
    # Implicit midpoint, k = h d / m: the speed errs by k^2 / 12 of its change, the position, on the mean of the old and
    # the new speed, by k / 12 of what the change moves it in a step; twice that is allowed.
    k = DRIVE.time_step * damping / mass
    allowed = abs(speed - v) * np.array([DRIVE.time_step * k, k**2]) / 6
    np.testing.assert_array_less(np.abs(got - np.array([p, v])), 1e-6 + allowed)


@pytest.mark.parametrize(
    ("params", "state", "command", "expected"),
    [
        ((0.32, 0.3, 1.0, 0.0), (1.0, 2.0, math.pi / 2, 1.0), (1.0, 0.0), (1.0, 2.05, math.pi / 2, 1.0)),
        # A gain of 2 commands 2 m/s: v = 2 - exp(-0.05 / 0.05), distance 2 h - (1 - 1/e) tau.
        ((0.32, 0.05, 2.0, 0.0), (0.0, 0.0, 0.0, 1.0), (1.0, 0.0), (0.05 + 0.05 / math.e, 0.0, 0.0, 2 - 1 / math.e)),
        # tan = 0.32 turns by the distance: 0.05 m, 0.05 rad; half of the angle comes from the trim.
        (
            (0.32, 0.3, 1.0, math.atan(0.32) / 2), (0.0, 0.0, 0.0, 1.0), (1.0, math.atan(0.32) / 2),
            (0.05 * math.cos(0.025), 0.05 * math.sin(0.025), 0.05, 1.0),
        ),
    ],
)  # fmt: skip
def test_car_by_hand(params: tuple, state: tuple, command: tuple, expected: tuple) -> None:
    got = CAR.step(jnp.array(params), jnp.array(state), jnp.array(command))
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-6)


@given(speed=st.floats(0.2, 2), steering=st.floats(0.05, 0.4))
@quick
def test_car_drives_a_circle(speed: float, steering: float) -> None:
    """At constant commands the rear axle stays wheelbase / tan(steering) from the circle's centre."""
    params, radius = jnp.array([0.32, 0.3, 1.0, 0.0]), 0.32 / math.tan(steering)
    state = jnp.array([radius, 0.0, jnp.pi / 2, speed])
    step = jax.jit(CAR.step)
    for _ in range(40):
        state = step(params, state, jnp.array([speed, steering]))
        chord = (0.05 * speed / radius) ** 2 / 12  # a chord as long as its arc leads outwards, relative to the radius
        assert math.hypot(state[0], state[1]) == pytest.approx(radius, rel=1e-4 + chord)


# The machines


def sample(machine: str, rows: int, seed: int) -> Recording:
    simulator, session = MACHINES[machine]
    return Recording(
        machine, np.arange(rows) * simulator.time_step, *session(np.random.default_rng(seed), rows, simulator.time_step)
    )


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=5, deadline=None)
def test_drive_stays_within_a_metre_and_its_force(seed: int) -> None:
    _, _, states, commands = sample("drive", 750, seed)
    assert states.shape == (750, 2)
    assert commands.shape == (750, 1)
    assert np.abs(states[:, 0]).max() < 1.0
    assert np.abs(commands).max() <= DriveConfig().force


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=5, deadline=None)
def test_car_stays_within_its_commands(seed: int) -> None:
    _, _, states, commands = sample("car", 300, seed)
    config = CarConfig()
    assert states.shape == (300, 4)
    assert commands.shape == (300, 2)
    assert np.all((commands[:, 0] >= config.slowest) & (commands[:, 0] <= config.fastest))
    assert np.abs(commands[:, 1]).max() <= config.lock
    assert np.all((states[:, 2] > -np.pi) & (states[:, 2] <= np.pi))


def test_drive_sticks_until_the_force_exceeds_the_friction() -> None:
    states, commands = drive_session(np.random.default_rng(0), 3000, 0.02, QUIET_DRIVE)
    now, then, force = states[:-1, 1], states[1:, 1], commands[:-1, 0]
    at_rest = now == 0
    assert 100 < np.sum(at_rest & (force != 0)) < 2900
    weak = np.abs(force) <= QUIET_DRIVE.friction
    assert np.all(then[at_rest & weak] == 0)
    assert np.all(then[at_rest & ~weak] * force[at_rest & ~weak] > 0)
    assert np.all(states[1:, 0][at_rest & weak] == states[:-1, 0][at_rest & weak])


def test_moving_drive_loses_its_friction() -> None:
    """Between rows without reversal, m v' = F - d v -+ friction."""
    states, commands = drive_session(np.random.default_rng(1), 3000, 0.02, QUIET_DRIVE)
    now, then, force = states[:-1, 1], states[1:, 1], commands[:-1, 0]
    moving = (np.abs(now) > 0.05) & (now * then > 0)
    c = QUIET_DRIVE
    lost = force - c.damping * (now + then) / 2 - c.mass * (then - now) / 0.02
    np.testing.assert_allclose(lost[moving] * np.sign(now[moving]), c.friction, rtol=0.02)


@pytest.mark.parametrize("rows_late", [0, 3])
def test_car_steers_by_what_was_commanded_before(rows_late: int) -> None:
    """Yaw per distance is tan(steering) / wheelbase, with the steering of 0.15 s = 3 rows ago; not of now."""
    states, commands = car_session(np.random.default_rng(0), 600, 0.05, QUIET_CAR)
    turned = (np.diff(states[:, 2]) + np.pi) % (2 * np.pi) - np.pi
    distance = (states[1:, 3] + states[:-1, 3]) / 2 * 0.05
    steering = np.concatenate([np.zeros(rows_late), commands[: len(turned) - rows_late, 1]])
    error = np.abs(turned - distance * np.tan(steering) / QUIET_CAR.wheelbase)
    assert (error.max() < 1e-3) == (rows_late == 3)


@pytest.mark.parametrize("machine", MACHINES)
def test_recordings_are_read_back(machine: str, tmp_path: Path) -> None:
    simulator, _ = MACHINES[machine]
    paths = record(machine, tmp_path, sessions=2, seconds=3.0, seed=0)
    recordings, errors = read_recordings(tmp_path, simulator.schema, simulator.time_step)
    assert errors == []
    assert [r.name for r in recordings] == [p.stem for p in paths] == [f"{machine}_01", f"{machine}_02"]
    rows = round(3.0 / simulator.time_step)
    for r in recordings:
        np.testing.assert_allclose(r.time_s, np.arange(rows) * simulator.time_step)
        assert r.state.shape == (rows, len(simulator.schema.state))
        assert r.command.shape == (rows, len(simulator.schema.command))
    assert not np.allclose(recordings[0].command, recordings[1].command)


def test_a_seed_makes_the_same_recordings(tmp_path: Path) -> None:
    content = [record("drive", tmp_path / n, 1, 2.0, seed)[0].read_bytes() for n, seed in zip("abc", (0, 0, 1))]  # noqa: B905
    assert content[0] == content[1] != content[2]


def test_the_command_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "examples.record", "car", str(tmp_path), "--sessions", "1", "--seconds", "2"]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert said == f"{tmp_path}: 1 x 2 s of the car\n"
    assert [p.name for p in tmp_path.iterdir()] == ["car_01.parquet"]


@pytest.mark.parametrize(
    ("option", "values", "words"),
    [
        ("--sessions", ("-1", "0", "1e3", "many", "1001"), "must be a whole number from 1 to 1,000"),
        ("--seconds", ("nan", "inf", "-1", "0", "1e9"), "must be a number from 0.1 to 3,600"),
        ("--seed", ("-1", "0.5", str(2**31)), "must be a whole number from 0 to 2,147,483,647"),
    ],
)
def test_a_number_that_cannot_be_is_refused(
    option: str, values: tuple[str, ...], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    for value in values:
        monkeypatch.setattr(sys, "argv", ["record", "drive", str(tmp_path), f"{option}={value}"])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        assert capsys.readouterr().err.endswith(f"error: argument {option}: {words}; it is '{value}'\n")
    assert not list(tmp_path.iterdir())


# The page


def printed() -> str:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "how_to" / "own_simulator.md").read_text(), re.DOTALL)
    return code


def test_the_pages_example_works_under_the_name_that_the_page_gives_it(tmp_path: Path) -> None:
    """`pendulum:PENDULUM finds ./pendulum.py`, and not the library of that name."""
    page = (ROOT / "docs" / "how_to" / "own_simulator.md").read_text()
    ((spec, file),) = re.findall(r"--simulator (\w+:\w+)` finds `\./([\w.]+)`", page)
    (tmp_path / file).write_text(printed())
    time = np.arange(400) * 0.02
    for name, phase in (("one", 0.0), ("two", 1.0)):
        rows = np.stack([time, 0.1 * np.sin(time + phase), 0.1 * np.cos(time + phase), np.sin(2 * time + phase)], 1)
        text = "time_s,angle,rate,torque\n" + "\n".join(",".join(map(str, row)) for row in rows)
        (tmp_path / f"{name}.csv").write_text(text)
    simgap = Path(sys.executable).parent / "simgap"
    command = [simgap, "check", ".", "--simulator", spec]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 sessions, 800 rows" in done.stdout


def test_the_pages_example_is_a_simulator() -> None:
    made: dict = {}
    exec(printed(), made)
    check(made["PENDULUM"], "pendulum.py:PENDULUM")
    # At rest at the bottom it stays; a torque of 1 N m on 0.5 kg m^2 gives 2 rad/s^2.
    step = made["PENDULUM"].step
    np.testing.assert_allclose(step(jnp.array([0.5, 5.0, 0.1]), jnp.zeros(2), jnp.zeros(1)), 0.0)
    np.testing.assert_allclose(step(jnp.array([0.5, 5.0, 0.1]), jnp.zeros(2), jnp.ones(1)), [4e-4, 0.04], rtol=1e-5)


# Spot with a part taken out


@given(omega=st.floats(-2, 2), x=st.floats(-1, 1), y=st.floats(-1, 1))
@quick
def test_without_induced_velocity_turning_leaves_the_hand(omega: float, x: float, y: float) -> None:
    """What is taken out is omega times the arm, turned by a quarter, and its part of the position; no more."""
    params = jnp.array([0.0] * 18 + [1.5] * 6)
    state = jnp.zeros(12).at[6:9].set(jnp.array([x, y, 0.5]))
    command = jnp.array([0.3, -0.2, omega, 0.1, 0.2, 0.3])
    whole, knocked_out = (s.step(params, state, command) for s in (Spot(), WITHOUT_INDUCED_VELOCITY))
    induced = np.array([-omega * y, omega * x, 0.0])
    np.testing.assert_allclose(whole[9:] - knocked_out[9:], induced, atol=1e-6)
    np.testing.assert_allclose(whole[6:9] - knocked_out[6:9], induced * 1.5 / 15, atol=1e-6)
    np.testing.assert_array_equal(whole[:6], knocked_out[:6])


def test_late_commands_stand_before_the_row_they_act_in() -> None:
    time = np.arange(6.0)
    recording = Recording("a", time, time[:, None], 10 * time[:, None])
    shifted = late(recording, 2)
    np.testing.assert_array_equal(shifted.state[:, 0], [0, 1, 2, 3])
    np.testing.assert_array_equal(shifted.command[:, 0], [20, 30, 40, 50])


def test_the_command_line_writes_late_recordings(tmp_path: Path) -> None:
    time, rows = np.arange(5) / 15, np.arange(5)[:, None] / 2
    write_recording(tmp_path / "a", Recording("s", time, rows + np.zeros(12), rows + np.zeros(6)), SCHEMA)
    command = [sys.executable, "-m", "examples.knockouts", str(tmp_path / "a"), str(tmp_path / "b"), "--rows", "1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr + done.stdout
    ((written,), errors) = read_recordings(tmp_path / "b", SCHEMA, 1 / 15)
    assert not errors
    np.testing.assert_array_equal(written.command[:, 0], [0.5, 1.0, 1.5, 2.0])
    np.testing.assert_array_equal(written.state[:, 0], [0.0, 0.5, 1.0, 1.5])


@pytest.mark.long
def test_the_notebook_runs_and_finds_the_friction() -> None:
    """As a person runs it, in a kernel of its own, from the project's folder."""
    notebook = nbformat.read(ROOT / "examples" / "diagnosis.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)  # as it is committed
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": ROOT}}).execute()
    kinds = {kind for cell in notebook.cells for out in cell.get("outputs", []) for kind in out.get("data", {})}
    assert {"image/svg+xml", "text/html"} <= kinds
    printed = "".join(out.get("text", "") for cell in notebook.cells for out in cell.get("outputs", []))
    assert "coulomb_friction" in printed
    position, speed = map(float, re.findall(r"comes to rest at \[ *([-\d.e]+) +([-\d.e]+) *\]", printed)[0])
    assert position > 0
    assert abs(speed) < 0.05
