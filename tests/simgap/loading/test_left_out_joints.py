"""A joint of a model file whose velocity has other units than its position is left out, and the rest is diagnosed."""

import json
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import simgap
from examples.arm import MODEL, ArmConfig, record_arm
from examples.drive import DRIVE
from examples.record import record
from simgap.cli import diagnose as command
from simgap.formats.purposes import Folders
from simgap.loading.model_files import ModelFile
from simgap.types import RecordingError

FACTOR = 0.425
"""As of the gripper of the SO-101."""
NOTE = "the joint elbow is left out, as if its columns were not recorded: in recordings, elbow_pos changes 0.4"


def tables(folder: Path, joints: tuple[str, ...]) -> dict[str, pd.DataFrame]:
    """The sessions of a folder, with velocities in other units for some joints."""
    found = {path.stem: pd.read_parquet(path) for path in sorted(folder.glob("*.parquet"))}
    return {
        name: table.assign(**{f"{joint}_vel": table[f"{joint}_vel"] / FACTOR for joint in joints})
        for name, table in found.items()
    }


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four sessions of an arm whose shoulder has dry friction, which the model lacks.

    Its elbow will move unseen, so something else is missing as well: in shorter ones the friction has no name.
    """
    folder = tmp_path_factory.mktemp("logs")
    record_arm(folder, 4, 4.0, 0, ArmConfig())
    return folder


@pytest.fixture(scope="module")
def heard() -> list[str]:
    return []


@pytest.fixture(scope="module")
def result(logs: Path, heard: list[str]) -> simgap.Result:
    return simgap.diagnose(MODEL, tables(logs, ("elbow",)), progress=heard.append)


@pytest.mark.long
def test_the_rest_is_diagnosed(result: simgap.Result, heard: list[str]) -> None:
    names = [f.name for f in (*result.diagnosed.schema.state, *result.diagnosed.schema.command)]
    assert names == ["pan_pos", "shoulder_pos", "pan_vel", "shoulder_vel", "cmd_pan", "cmd_shoulder"]
    (effect,) = result.effects
    assert effect.id == "coulomb_friction"
    assert set(effect.outputs) <= {"shoulder_pos", "shoulder_vel"}
    assert [p["name"] for p in result.statement["replay"]["positions"]] == ["pan_pos", "shoulder_pos"]
    assert not any("elbow" in name for name in result.statement["parameters"]["fitted"])
    assert heard[0] == result.statement["notes"][0]


@pytest.mark.long
def test_a_note_names_the_joint_the_reason_and_the_remedy(result: simgap.Result) -> None:
    (note,) = (note for note in result.statement["notes"] if "left out" in note)
    assert note.startswith(NOTE)
    assert "Give `unit` or `sign` in the mapping (`simgap import`)" in note
    assert NOTE in result.to_html()


@pytest.mark.long
def test_what_is_saved_is_loaded_again(result: simgap.Result, tmp_path: Path) -> None:
    result.save(tmp_path)
    columns = json.loads((tmp_path / "diagnosis.json").read_text())["model_file"]["columns"]
    assert {"elbow_pos", "elbow_vel"}.isdisjoint(columns)
    state, command = np.array([0.1, -0.2, 0.3, -0.4]), np.array([0.2, -0.1])
    phi = jnp.asarray(simgap.nominal(result.simulator))
    after = [robot.step(phi, state, command) for robot in (result.simulator, simgap.load(tmp_path))]
    np.testing.assert_array_equal(*after)
    patched = simgap.ModelFile(tmp_path / "arm.patched.xml").columns(0.02)
    assert patched == simgap.ModelFile(MODEL).columns(0.02)  # the joint stays in the model


def test_the_command_says_it_of_folders(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As far as the search, which does not run. Only the baseline has other units."""
    (tmp_path / "before").mkdir()
    for name, table in tables(logs, ("elbow",)).items():
        table.iloc[5:].to_parquet(tmp_path / "before" / f"{name}.parquet")
    asked: list[Any] = []

    def search(*given: Any) -> None:
        asked.append(given)
        raise InterruptedError

    monkeypatch.setattr(command, "diagnose", search)
    with pytest.raises(InterruptedError):
        command.diagnose_folder(
            Folders(logs, baseline=tmp_path / "before"), ModelFile(MODEL), tmp_path / "out", 0, False
        )
    said = " ".join(capsys.readouterr().out.split())
    assert f"note: {NOTE.replace('in recordings', 'in before')}" in said
    assert said.count("elbow is left out") == 1
    ((_, _, sessions, *_),) = asked
    assert {(r.state.shape, r.command.shape) for r in sessions.training} == {((200, 4), (200, 2))}
    assert sessions.baseline[0].state.shape == (195, 4)
    original = pd.read_parquet(logs / f"{sessions.training[0].name}.parquet")
    columns = ["pan_pos", "shoulder_pos", "pan_vel", "shoulder_vel"]
    np.testing.assert_array_equal(sessions.training[0].state, original[columns].to_numpy())


def test_without_any_other_joint_the_recordings_are_refused(logs: Path) -> None:
    words = "(?s)column pan_pos changes 0.4.*column shoulder_pos.*column elbow_pos changes 0.4"
    with pytest.raises(RecordingError, match=words):
        simgap.diagnose(MODEL, tables(logs, ("pan", "shoulder", "elbow")))


def test_a_simulator_with_columns_of_its_own_refuses_them(tmp_path: Path) -> None:
    record("drive", tmp_path, sessions=2, seconds=4.0, seed=0)
    table = pd.read_parquet(next(iter(tmp_path.glob("*.parquet"))))
    table["velocity"] /= FACTOR
    with pytest.raises(RecordingError, match=f"recordings: column position changes {FACTOR} times as fast as velocity"):
        simgap.diagnose(DRIVE, table)
