"""What surrounds a diagnosis: sessions that serve one purpose each, files, and scores as MLflow takes them."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from examples.drive import DRIVE
from examples.record import record
from simgap.diagnosis.diagnose import AugmentedModel, Diagnosis
from simgap.effects.effect import Scales
from simgap.effects.regime import everywhere
from simgap.formats.arrays import load_arrays
from simgap.formats.atomic import remove_unfinished
from simgap.formats.documents import read_json
from simgap.formats.recordings import digest, read_recordings, write_recording
from simgap.types import Recording, RecordingError
from tasks import diagnose
from tasks.diagnose import Folders

STATEMENT: dict[str, Any] = {
    "schema": 2, "simulator": "drive", "verdict": "missing_physics", "statement": "Friction of 2.5 N [sic] is missing.",
    "effects": [{"id": "coulomb_friction", "probability": 0.97}],
    "fit": {"models": {"nominal": {"nll_1": {"value": -1.5, "ci95": [-1.6, -1.4]},
                                 "error_50_cart [m]": {"value": 0.25, "ci95": [0.2, 0.3]}},
                       "augmented": {"nll_1": {"value": float("nan"), "ci95": [0.0, 0.0]}}},
            "explained_share": None},
}  # fmt: skip
SCALES = Scales(**{**dict.fromkeys(Scales._fields, np.ones(2)), "duration": 2.0, "time_step": 0.02})
MODEL = AugmentedModel(
    np.array([2.0, 4.0]), *everywhere(np.zeros(7)), np.ones(2), np.full(2, 0.1), np.full(2, np.inf), np.eye(2), SCALES
)
EXPERIMENT = (np.arange(3) * 0.02, np.array([[0.0], [15.0], [-15.0]]))


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Recording sets of two sessions each, whose names are the same."""
    root = tmp_path_factory.mktemp("recordings")
    for seed, name in enumerate(("today", "tomorrow", "yesterday")):
        record("drive", root / name, sessions=2, seconds=2.0, seed=seed)
    return {path.name: path for path in root.iterdir()}


def names(recordings: list[Recording]) -> list[str]:
    return [r.name for r in recordings]


def test_sessions_are_held_out_where_no_folder_is(folders: dict[str, Path]) -> None:
    sessions, errors = diagnose.read.fn(Folders(folders["today"]), DRIVE)
    assert sorted(names(sessions.training) + names(sessions.heldout)) == ["drive_01", "drive_02"]
    assert len(sessions.heldout) == 1
    assert (sessions.baseline, errors) == ([], [])


def test_sessions_of_one_name_are_told_apart(folders: dict[str, Path]) -> None:
    given = Folders(folders["today"], folders["tomorrow"], folders["yesterday"])
    sessions, _ = diagnose.read.fn(given, DRIVE)
    assert names(sessions.training) == ["drive_01", "drive_02"]
    assert names(sessions.heldout) == ["tomorrow/drive_01", "tomorrow/drive_02"]
    assert names(sessions.baseline) == ["yesterday/drive_01", "yesterday/drive_02"]


def test_recordings_of_several_experiments_are_put_together(folders: dict[str, Path]) -> None:
    given = Folders(folders["today"], further=(folders["tomorrow"], folders["yesterday"]))
    sessions, _ = diagnose.read.fn(given, DRIVE)
    assert names(sessions.training) == ["drive_01", "drive_02", "tomorrow/drive_01", "yesterday/drive_01",
                                        "yesterday/drive_02"]  # fmt: skip
    assert names(sessions.heldout) == ["tomorrow/drive_02"]
    with pytest.raises(RecordingError, match=r"the session drive_01 is the session drive_01 of another folder"):
        diagnose.read.fn(Folders(folders["today"], further=(folders["today"],)), DRIVE)


@pytest.mark.parametrize("purpose", ["recordings", "heldout", "baseline"])
def test_a_velocity_that_is_a_difference_is_refused(folders: dict[str, Path], tmp_path: Path, purpose: str) -> None:
    for session in read_recordings(folders["tomorrow"], DRIVE.schema, DRIVE.time_step)[0]:
        session.state[:, 1] = np.gradient(session.state[:, 0], session.time_s)
        write_recording(tmp_path / "made", session, DRIVE.schema)
    given = Folders(folders["today"])._replace(**{purpose: tmp_path / "made"})
    words = r"made: column velocity is the central difference of position.*Record the velocity that a sensor gives"
    with pytest.raises(RecordingError, match=words):
        diagnose.read.fn(given, DRIVE)


@pytest.mark.parametrize("purpose", ["heldout", "baseline"])
def test_a_session_serves_one_purpose(folders: dict[str, Path], tmp_path: Path, purpose: str) -> None:
    (session,) = (read_recordings(folders["today"], DRIVE.schema, DRIVE.time_step, ["drive_02*"]))[0]
    write_recording(tmp_path / "copy", session._replace(name="another"), DRIVE.schema)
    given = Folders(folders["today"])._replace(**{purpose: tmp_path / "copy"})
    with pytest.raises(RecordingError, match=r"copy: the session another is the session drive_02"):
        diagnose.read.fn(given, DRIVE)


def test_unusable_sessions_are_told_and_left_out(tmp_path: Path) -> None:
    record("drive", tmp_path, sessions=2, seconds=2.0, seed=0)
    (tmp_path / "broken.csv").write_text("time_s,position\n0,0\n")
    sessions, errors = diagnose.read.fn(Folders(tmp_path), DRIVE)
    assert len(sessions.training) + len(sessions.heldout) == 2
    assert len(errors) == 1
    assert "broken.csv: column velocity, cmd_force is missing" in errors[0]


def test_a_digest_identifies_numbers_not_names(folders: dict[str, Path]) -> None:
    (a, b), _ = read_recordings(folders["today"], DRIVE.schema, DRIVE.time_step)
    assert digest([a]) == digest([a._replace(name="b")])
    assert len({digest(rs) for rs in ([a], [b], [a, b], [b, a])}) == 4


def test_what_is_written_reads_back_and_an_old_experiment_goes(tmp_path: Path) -> None:
    found = Diagnosis(STATEMENT, {}, MODEL, EXPERIMENT)
    diagnose.write.fn(tmp_path, found, DRIVE.schema)
    assert read_json(tmp_path / "diagnosis.json")["statement"] == STATEMENT["statement"]
    assert STATEMENT["statement"] in (tmp_path / "diagnosis.html").read_text()
    commands = pd.read_csv(tmp_path / "experiment.csv")
    assert list(commands.columns) == ["time_s", "cmd_force"]
    np.testing.assert_allclose(commands.to_numpy(), np.column_stack(EXPERIMENT))
    arrays = load_arrays(tmp_path / "augmented.npz")
    written = MODEL._asdict()
    written |= {f"scales_{name}": np.asarray(scale) for name, scale in written.pop("scales")._asdict().items()}
    assert {name: a.tolist() for name, a in arrays.items()} == {n: np.asarray(a).tolist() for n, a in written.items()}

    diagnose.write.fn(tmp_path, found._replace(experiment=None), DRIVE.schema)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["augmented.npz", "diagnosis.html", "diagnosis.json"]


KILLED = """
import os, signal, sys
from pathlib import Path
from test_diagnose_stage import DRIVE, EXPERIMENT, MODEL, STATEMENT, Diagnosis, diagnose

def replaced(source, target, replace=os.replace):
    if target.name == "diagnosis.html":
        os.kill(os.getpid(), signal.SIGKILL)
    replace(source, target)

os.replace = replaced
diagnose.write.fn(Path(sys.argv[1]), Diagnosis(STATEMENT, {}, MODEL, EXPERIMENT), DRIVE.schema)
"""


def test_a_diagnosis_killed_while_it_is_written_passes_for_none(tmp_path: Path) -> None:
    """Not for the one before either; the next is whole."""
    found = Diagnosis(STATEMENT, {}, MODEL, EXPERIMENT)
    diagnose.write.fn(tmp_path, found, DRIVE.schema)
    whole = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    here = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": f"{here}{os.pathsep}{here.parents[1]}"}
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], env=environment, timeout=200)
    assert done.returncode == -signal.SIGKILL
    assert {path.name for path in tmp_path.glob("[!.]*")} == {"augmented.npz", "experiment.csv"}
    remove_unfinished(tmp_path)
    diagnose.write.fn(tmp_path, found, DRIVE.schema)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == whole


def test_scores_are_flat_and_known() -> None:
    assert dict(diagnose.scores(STATEMENT)) == {"nominal/nll_1": -1.5, "nominal/error_50_cart": 0.25}
    whole = {**STATEMENT, "fit": {**STATEMENT["fit"], "explained_share": 0.9}}
    assert dict(diagnose.scores(whole))["explained_share"] == 0.9
