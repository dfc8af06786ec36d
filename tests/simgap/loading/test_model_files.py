"""Model files as simulators: columns and interval are the recordings'; mistakes are named; the engine comes back."""

import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import simgap
from examples.arm import MODEL, ArmConfig, record_arm
from simgap import api
from simgap.cli import diagnose as command
from simgap.cli.importing import import_recordings
from simgap.formats import peek, purposes
from simgap.formats.purposes import Folders
from simgap.formats.recordings import read_recordings
from simgap.loading.arrange import arranged
from simgap.loading.load import prepared, started
from simgap.loading.model_files import ModelFile, recalled
from simgap.types import ConfigError, RecordingError

COMMAND = str(Path(sys.executable).parent / "simgap")
JOINTS = ("pan", "shoulder", "elbow")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three sessions at 50 Hz, of positions only."""
    folder = tmp_path_factory.mktemp("logs")
    record_arm(folder, 3, 1.5, 0, ArmConfig(speeds=False))
    return folder


def seen(folder: Path) -> peek.Seen:
    return peek.in_folders([folder])


def test_columns_and_interval_are_those_of_the_recordings(logs: Path) -> None:
    used = prepared(ModelFile(MODEL), lambda: seen(logs))
    assert used.name == str(MODEL)
    assert used.simulator.time_step == 0.02
    assert [f.name for f in used.simulator.schema.state if not f.observed] == [f"{j}_vel" for j in JOINTS]
    given, errors = purposes.read(Folders(logs), used.simulator)
    assert errors == []
    assert given.recordings.sessions[0].state.shape == (75, 3)


def test_a_column_counts_that_most_files_have(logs: Path, tmp_path: Path) -> None:
    recordings = [pd.read_parquet(path) for path in sorted(logs.glob("*.parquet"))]
    for k, table in enumerate(recordings):
        table.assign(pan_vel=0.0).to_csv(tmp_path / f"{k}.csv", index=False)
    recordings[0].drop(columns="cmd_pan").to_csv(tmp_path / "short.csv", index=False)
    (tmp_path / "note.csv").write_text("hello\n")
    found = seen(tmp_path)
    assert {"pan_vel", "cmd_pan"} <= set(found.columns)
    used = prepared(ModelFile(MODEL), lambda: found)
    given, errors = purposes.read(Folders(tmp_path), used.simulator)
    assert len(given.recordings.sessions) == 3
    assert any("short.csv: column pan_vel, cmd_pan is missing" in error for error in errors)


def test_the_engine_is_remembered(logs: Path) -> None:
    used = prepared(ModelFile(MODEL), lambda: seen(logs))
    assert used.model_file is not None
    again = recalled(json.loads(json.dumps(used.model_file)))
    assert again.schema == used.simulator.schema
    with pytest.raises(ConfigError, match=r"gone\.xml: there is no such file"):
        recalled({**used.model_file, "path": "gone.xml"})


@pytest.fixture
def stiff(tmp_path: Path) -> Path:
    """The arm's model with servos that are twenty times too stiff."""
    path = tmp_path / "stiff.xml"
    path.write_text(re.sub(r'kp="(\d+)"', lambda kp: f'kp="{20 * int(kp[1])}"', MODEL.read_text()))
    return path


def test_servos_that_are_wrong_by_far_are_rescaled_first(logs: Path, stiff: Path) -> None:
    said: list[str] = []
    used = prepared(ModelFile(stiff), lambda: seen(logs))
    begun = started(*arranged(used, purposes.read(Folders(logs), used.simulator)[0], pytest.fail), said.append)
    assert [words[:56] for words in said] == [
        "The model's position servos are about 20 times too stiff",
        "At rest, servos sag under the weight that they hold: sho",
    ]
    shares = np.exp(simgap.nominal(begun.simulator))
    names = [p.name for p in begun.simulator.parameters]
    assert shares == pytest.approx([1 / 20 if name.startswith("kp ") else 1.0 for name in names], rel=0.1)
    assert begun.model_file is not None
    again: Any = recalled(json.loads(json.dumps(begun.model_file)))
    assert again.parameters == begun.simulator.parameters
    # The true stiffness takes longer steps than the model's own.
    assert again.steps == begun.simulator.steps < used.simulator.steps  # type: ignore[union-attr]


def test_servos_that_are_about_right_stay(logs: Path) -> None:
    used = prepared(ModelFile(MODEL), lambda: seen(logs))
    assert started(*arranged(used, purposes.read(Folders(logs), used.simulator)[0], pytest.fail), pytest.fail) is used


def test_python_and_the_command_start_from_the_same_model(
    logs: Path, stiff: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each as far as the search, which does not run."""
    begun: list[Any] = []

    def search(simulator: Any, *_: Any) -> None:
        begun.append(simulator)
        raise InterruptedError

    monkeypatch.setattr(api, "find", search)
    monkeypatch.setattr(command, "diagnose", search)
    for ask in (
        lambda: simgap.diagnose(stiff, logs),
        lambda: command.diagnose_folder(Folders(logs), ModelFile(stiff), tmp_path / "out", 0, False),
    ):
        with pytest.raises(InterruptedError):
            ask()
    python, shell = begun
    assert python.parameters == shell.parameters
    assert simgap.nominal(python).min() < np.log(1 / 15)


def test_columns_that_match_nothing_are_named_on_both_sides(logs: Path, tmp_path: Path) -> None:
    table = pd.read_parquet(next(iter(logs.glob("*.parquet"))))
    table.rename(columns=lambda c: c.replace("_pos", "_position")).to_csv(tmp_path / "a.csv", index=False)
    words = r"takes the columns time_s, pan_pos.* have time_s, pan_position.*; nearest to pan_position is pan_pos"
    with pytest.raises(ConfigError, match=words):
        prepared(ModelFile(MODEL), lambda: seen(tmp_path))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["nowhere.xml"], "nowhere.xml: there is no such file. Give the path of the robot's MJCF or URDF."),
        (["spot", "--kp", "3"], "--kp, --kv and --force-limit are for a model file"),
        (["robot.xml", "--kp", "a=b"], "must be a number, or joint=number,joint=number; it is 'a=b'"),
        (["robot.xml", "--kp", "a=1,a=2"], "argument --kp: must have every joint once; it is 'a=1,a=2'"),
        (["robot.xml", "--kp=-5"], "robot.xml: kp is -5.0; it must be a number above 0 to 1e+09. Correct it"),
        (["robot.xml", "--kv", "a=nan"], "robot.xml: kv of a is nan; it must be a number from 0 to 1e+09."),
        (["spot", "--seed", "-1"], "seed is -1; it must be a whole number from 0 to 2,147,483,647."),
    ],
)
def test_a_wrong_argument_is_told_before_jax_is_loaded(logs: Path, given: list[str], words: str) -> None:
    code = "import sys; from simgap.cli.main import main\ntry: main()\nfinally: assert 'jax' not in sys.modules"
    command = [sys.executable, "-c", code, "diagnose", str(logs), "--simulator", *given]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode in (1, 2)
    assert words in " ".join((done.stdout + done.stderr).split())
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("option", ["kp", "kv", "force_limit"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -5, 1e300, "stiff", [3.0], 0])
def test_a_servo_that_cannot_be_is_refused(option: str, value: Any) -> None:
    """Of all joints and of one; without damping a servo may be, without stiffness or force not."""
    for given, words in ((value, option), ({"pan": 1.0, "elbow": value}, f"{option} of elbow")):
        if (option, value) == ("kv", 0):
            ModelFile(MODEL, **{option: given})
            continue
        with pytest.raises(ConfigError, match=re.escape(f"{MODEL}: {words} is {value!r}; it must be a number")):
            ModelFile(MODEL, **{option: given})


def test_without_mujoco_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ConfigError, match=r"pip install 'simgap\[mujoco\]'"):
        ModelFile(MODEL).check()


def test_logs_in_degrees_are_imported(logs: Path, tmp_path: Path) -> None:
    original = pd.read_parquet(logs / "arm_01.parquet")
    raw = pd.DataFrame({"stamp": 1000 * original["time_s"]})
    columns: dict[str, Any] = {}
    for name in ("pan_pos", "shoulder_pos", "cmd_pan"):
        raw[f"raw {name}"] = np.rad2deg(original[name])
        columns[name] = {"column": f"raw {name}", "unit": "deg"}
    raw.to_csv(tmp_path / "one.csv", index=False)
    time_column = {"column": "stamp", "unit": "ms"}
    mapping = {"rate_hz": 50, "longest_gap_s": 0.2, "time": time_column, "columns": columns}
    (tmp_path / "mapping.yaml").write_text(json.dumps(mapping))
    import_recordings(tmp_path / "one.csv", tmp_path / "mapping.yaml", tmp_path / "out", ModelFile(MODEL))
    schema = prepared(ModelFile(MODEL), lambda: seen(tmp_path / "out")).simulator.schema
    assert schema.columns == ("time_s", "pan_pos", "shoulder_pos", "cmd_pan")
    ((session,), errors) = read_recordings(tmp_path / "out", schema, 0.02)
    assert errors == []
    assert session.state[:, 0] == pytest.approx(original["pan_pos"][: len(session.state)].to_numpy(), abs=1e-6)
    mapping["columns"] = columns | {"tilt_pos": columns["pan_pos"]}
    (tmp_path / "mapping.yaml").write_text(json.dumps(mapping))
    words = (
        r"has the unknown tilt_pos; .* names; nearest to tilt_pos is .*Columns of the simulator: .*elbow_pos.*cmd_elbow"
    )
    with pytest.raises(ConfigError, match=words):
        import_recordings(tmp_path / "one.csv", tmp_path / "mapping.yaml", tmp_path / "out", ModelFile(MODEL))


def test_the_command_checks_recordings_of_positions(logs: Path, tmp_path: Path) -> None:
    start = time.perf_counter()
    command = [COMMAND, "check", str(logs), "--simulator", str(MODEL), "--out", str(tmp_path / "found")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 sessions, 225 rows" in done.stdout
    assert {p.name for p in tmp_path.iterdir()} == {"found"}
    assert time.perf_counter() - start < 120


def test_tables_in_memory_need_names(logs: Path) -> None:
    (recording, *_), _ = read_recordings(logs, prepared(ModelFile(MODEL), lambda: seen(logs)).simulator.schema, 0.02)
    with pytest.raises(RecordingError, match="with a model file it must be a table"):
        simgap.diagnose(MODEL, [recording])
    with pytest.raises(RecordingError, match="must have the column time_s"):
        simgap.diagnose(MODEL, [pd.DataFrame({"pan_pos": [0.0, 1.0]})])
