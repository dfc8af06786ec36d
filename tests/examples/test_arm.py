"""The arm: recordings that are read back, and that differ from the model by what they are said to miss."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from examples.arm import JOINTS, MISSING, MODEL, ArmConfig, arm_session, record_arm, schema
from simgap.formats.recordings import read_recordings
from simgap.simulators.mujoco import MujocoEngine, load

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def engine() -> MujocoEngine:
    return load(MODEL, ArmConfig.time_step)


def open_loop_error(engine: MujocoEngine, missing: str, phi: np.ndarray, **terms: float) -> np.ndarray:
    """Of the positions [rad], over a session of 200 rows; terms by effect and place, `payload_forearm=0.4`."""
    states, commands = arm_session(np.random.default_rng(3), 200, ArmConfig(missing))
    values = [terms.pop(f"{t.effect}_{t.where}", 0.0) for t in engine.terms]
    assert not terms
    predicted = engine.path(phi, np.array(values), states[0], commands)
    return np.sqrt(((predicted - states)[:, :3] ** 2).mean(0))


def test_nothing_missing_is_noise(engine: MujocoEngine) -> None:
    assert (open_loop_error(engine, "nothing", engine.nominal) < 4 * ArmConfig.position_noise).all()


@pytest.mark.parametrize("missing", [m for m in MISSING if m != "nothing"])
def test_what_is_missing_shows(engine: MujocoEngine, missing: str) -> None:
    assert open_loop_error(engine, missing, engine.nominal).max() > 8 * ArmConfig.position_noise


CURES = {
    "friction": {"coulomb_friction_shoulder": 0.3},
    "friction_all": {f"coulomb_friction_{joint}": 0.3 for joint in JOINTS},
    "payload": {"payload_forearm": 0.4},
    "gravity_compensation": {"joint_gravity_all": 0.5},
    "force_limit": {"force_limit_shoulder": 1 / 6},
    "interval": {"sampling_interval_all": -0.001},
}


@pytest.mark.parametrize("missing", CURES)
def test_the_engine_s_term_for_it_explains_it(engine: MujocoEngine, missing: str) -> None:
    assert (open_loop_error(engine, missing, engine.nominal, **CURES[missing]) < 4 * ArmConfig.position_noise).all()


@pytest.mark.parametrize(("missing", "share"), [("kp", 0.7), ("damping", 1.6)])
def test_a_wrong_parameter_is_a_parameter(engine: MujocoEngine, missing: str, share: float) -> None:
    phi = engine.nominal.copy()
    phi[[p.name for p in engine.parameters].index(f"{missing} shoulder")] = np.log(share)
    assert (open_loop_error(engine, missing, phi) < 4 * ArmConfig.position_noise).all()


@pytest.mark.parametrize("speeds", [True, False])
def test_recordings_are_read_back(tmp_path: Path, speeds: bool) -> None:
    record_arm(tmp_path, 2, 1.0, 0, ArmConfig(speeds=speeds))
    recordings, errors = read_recordings(tmp_path, schema(speeds), ArmConfig.time_step)
    assert errors == []
    assert [r.state.shape for r in recordings] == [(50, 6 if speeds else 3)] * 2
    assert schema(True).columns == load(MODEL, ArmConfig.time_step).schema.columns


def test_the_command(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "examples.record", "arm", str(tmp_path), "--sessions", "1", "--seconds", "1"]
    done = subprocess.run([*command, "--missing", "payload"], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "1 x 1 s of the arm" in done.stdout
    wrong = subprocess.run([*command, "--missing", "sand"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert "expected one of nothing, friction" in wrong.stderr
