"""The command `simgap diagnose` as a person runs it: in a folder of their own, with a simulator of their own."""

import html
import subprocess
import sys
from pathlib import Path
from typing import Any

import mlflow
import mlflow.pyfunc
import numpy as np
import pandas as pd
import pytest
from mlflow import MlflowClient
from prefect.settings import PREFECT_API_URL, temporary_settings

from examples.drive import DRIVE
from examples.record import record
from flows import command
from flows.diagnose import diagnose_folder
from simgap.types import SimgapError
from tasks import diagnose
from tasks.files.arrays import load_arrays
from tasks.files.documents import read_json

ROOT = Path(__file__).parents[2]
SIMULATORS = "from examples.drive import DRIVE\n\nBROKEN = object()\n"


def simgap(server: dict[str, str], folder: Path, *arguments: str) -> tuple[int, str]:
    """Exit status and what was printed."""
    done = subprocess.run(
        [Path(sys.executable).parent / "simgap", *arguments], cwd=folder, env={**server, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=600,
    )  # fmt: skip
    return done.returncode, done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person's folder: recordings of a drive with friction, one session damaged, and `mine.py`, a simulator."""
    folder = tmp_path_factory.mktemp("person")
    record("drive", folder / "rail", sessions=3, seconds=20.0, seed=0)
    (folder / "rail" / "broken.csv").write_text("time_s,position\n0,0\n")
    (folder / "empty").mkdir()
    (folder / "mine.py").write_text(SIMULATORS)
    return folder


@pytest.fixture(scope="module")
def output(folder: Path, prefect_server: dict[str, str]) -> str:
    """What a diagnosis prints."""
    status, output = simgap(prefect_server, folder, "diagnose", "rail", "--simulator", "mine:DRIVE", "--out", "found")
    assert status == 0, output
    return output


def test_the_statement_is_told_and_where_the_page_is(folder: Path, output: str) -> None:
    found = read_json(folder / "found" / "diagnosis.json")
    assert found["verdict"] in ("missing_physics", "parameters_only", "nothing", "unexplained", "inconclusive")
    assert found["simulator"] == "mine:DRIVE"
    assert found["statement"] in output
    (page,) = [line.split()[1] for line in output.splitlines() if line.startswith("page ")]
    assert html.escape(found["statement"]) in (folder / page).read_text()
    assert "left out: rail/broken.csv: column velocity, cmd_force is missing" in output
    assert "Traceback" not in output
    assert "Warning" not in output


def test_the_experiment_is_there_if_it_is_called_for(folder: Path, output: str) -> None:
    found = read_json(folder / "found" / "diagnosis.json")
    commands = folder / "found" / "experiment.csv"
    assert commands.exists() == bool(found["experiment"])
    assert ("commands  found/experiment.csv" in output) == commands.exists()
    if commands.exists():
        table = pd.read_csv(commands)
        assert list(table.columns) == ["time_s", "cmd_force"]
        assert table["time_s"].diff().dropna().to_numpy() == pytest.approx(0.02)


def test_the_diagnosis_is_a_run_in_mlflow(folder: Path, output: str) -> None:
    client = MlflowClient(f"sqlite:///{folder / 'mlflow.db'}")
    experiment = client.get_experiment_by_name("diagnosis")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.run_id in output
    assert (run.info.run_name, run.info.status) == ("rail-mine:DRIVE", "FINISHED")
    found = read_json(folder / "found" / "diagnosis.json")
    tags = run.data.tags
    assert tags["verdict"] == found["verdict"]
    assert tags["effects"] == (", ".join(e["id"] for e in found["effects"]) or "none")
    assert tags["mlflow.note.content"] == found["statement"]
    assert tags["prefect_flow_run"]
    params = run.data.params
    assert (params["simulator"], params["baseline"]) == ("mine:DRIVE", "none")
    assert (params["sessions.training"], params["sessions.heldout"], params["transitions"]) == ("2", "1", "1998")
    assert [(i.dataset.name, i.tags[0].value) for i in run.inputs.dataset_inputs] == [
        ("rail-training", "training"), ("rail-heldout", "heldout"),
    ]  # fmt: skip
    scores = dict(diagnose.scores(found))
    assert {"as_is/nll_1", "refitted/nll_1", "black_box/nll_1"} <= set(scores)
    assert run.data.metrics == pytest.approx(
        {**scores, "effects": len(found["effects"]), "seconds": run.data.metrics["seconds"]}
    )
    logged = {file.path for file in client.list_artifacts(run.info.run_id)}
    assert logged == {path.name for path in (folder / "found").iterdir() if path.name != ".lock"}
    assert {"diagnosis.json", "diagnosis.html", "augmented.npz"} <= logged


@pytest.mark.usefixtures("output")
def test_the_augmented_simulator_is_a_model_in_mlflow(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(folder))  # the simulator's own module must be importable
    store = f"sqlite:///{folder / 'mlflow.db'}"
    client = MlflowClient(store)
    experiment = client.get_experiment_by_name("diagnosis")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.outputs is not None
    (logged,) = run.outputs.model_outputs
    mlflow.set_tracking_uri(store)
    monkeypatch.chdir(folder)  # where the store's artifacts are
    model = mlflow.pyfunc.load_model(f"models:/{logged.model_id}")
    row = pd.DataFrame([{"position": 0.1, "velocity": 0.2, "cmd_force_2": 1.0, "cmd_force_1": 1.5, "cmd_force": 2.0}])
    got = model.predict(row)
    assert list(got.columns) == ["next_position", "next_velocity"]
    found = load_arrays(folder / "found" / "augmented.npz")
    if not found["theta"].any():  # nothing was found in these few rows: it is the simulator itself
        expected = DRIVE.step(found["phi"], np.array([0.1, 0.2], np.float32), np.array([2.0], np.float32))
        np.testing.assert_allclose(got.to_numpy()[0], expected, rtol=1e-5)
    assert np.isfinite(got.to_numpy()).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["empty", "--simulator", "mine:DRIVE"], ["empty: no file matches", "put the sessions there"]),
        (["rail", "--simulator", "mine:BROKEN"], ["mine:BROKEN: a simulator must have schema"]),
    ],
)
def test_wrong_input_is_explained_without_a_traceback(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
    prefect_server: dict[str, str], arguments: list[str], words: list[str],
) -> None:  # fmt: skip
    """The command, but in this process: of another one, all time would be its imports."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["simgap", "diagnose", *arguments])
    monkeypatch.setattr(sys, "path", [*sys.path])  # the command adds the folder, for `mine`
    served = temporary_settings({PREFECT_API_URL: prefect_server["PREFECT_API_URL"]})
    with served, pytest.raises(SystemExit) as ended:
        command.main()
    sys.modules.pop("mine", None)
    output = "".join(capfd.readouterr())
    assert ended.value.code == 1, output
    assert all(word in output for word in words), output
    assert "Traceback" not in output
    assert not (folder / "diagnosis").exists()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"recordings": Path("nowhere")}, "nowhere: there is no such folder"),
        ({"simulator": "mine"}, "package.module:name"),
        ({"simulator": "os:abort"}, "a simulator must have schema"),
        ({"heldout": Path("rail")}, "a session must serve one purpose"),
        ({"baseline": Path("rail")}, "a session must serve one purpose"),
        ({"out": Path("mine.py")}, "mine.py: must be a folder"),
    ],
)
def test_wrong_input_is_refused_before_any_work(
    folder: Path, monkeypatch: pytest.MonkeyPatch, prefect_server: dict[str, str], given: dict[str, Any], words: str
) -> None:
    """In the flow, which Prefect's form starts too."""
    monkeypatch.chdir(folder)
    right = {"recordings": Path("rail"), "simulator": "examples.drive:DRIVE", "baseline": None, "heldout": None}
    served = temporary_settings({PREFECT_API_URL: prefect_server["PREFECT_API_URL"]})
    with served, pytest.raises(SimgapError, match=words):
        diagnose_folder(**{**right, "out": Path("unused"), **given})
    assert not (folder / "unused").exists()
