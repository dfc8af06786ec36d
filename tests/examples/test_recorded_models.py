"""Recordings of machines with a model file are read back, and the command writes them."""

import subprocess
import sys
from pathlib import Path

import pytest

from examples import arm, drone
from simgap.formats.recordings import read_recordings
from simgap.simulators.mujoco import load

ROOT = Path(__file__).parents[2]
MACHINES = {"arm": (arm, arm.ArmConfig, arm.record_arm, 3), "drone": (drone, drone.DroneConfig, drone.record_drone, 6)}


@pytest.mark.parametrize("speeds", [True, False])
@pytest.mark.parametrize("name", MACHINES)
def test_recordings_are_read_back(tmp_path: Path, name: str, speeds: bool) -> None:
    machine, config, record, positions = MACHINES[name]
    record(tmp_path, 2, 1.0, 0, config(speeds=speeds))
    recordings, errors = read_recordings(tmp_path, machine.schema(speeds), config.time_step)
    assert errors == []
    assert [r.state.shape for r in recordings] == [(50, 2 * positions if speeds else positions)] * 2
    assert machine.schema(True).columns == load(machine.MODEL, config.time_step).schema.columns


@pytest.mark.parametrize(
    ("name", "missing", "known"), [("arm", "payload", "nothing, friction"), ("drone", "wind", "nothing, payload")]
)
def test_the_command(tmp_path: Path, name: str, missing: str, known: str) -> None:
    command = [sys.executable, "-m", "examples.record", name, str(tmp_path), "--sessions", "1", "--seconds", "1"]
    done = subprocess.run([*command, "--missing", missing], cwd=ROOT, capture_output=True, text=True, check=True)
    assert f"1 x 1 s of the {name}" in done.stdout
    wrong = subprocess.run([*command, "--missing", "sand"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert f"expected one of {known}" in wrong.stderr
