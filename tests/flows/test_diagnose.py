"""Diagnoses in flows, with a Prefect server: a folder's, as a run in MLflow, and those that cells are trained with."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mlflow
import mlflow.pyfunc
import numpy as np
import pandas as pd
import pytest
import yaml
from killing import worker
from mlflow import MlflowClient
from prefect.settings import PREFECT_API_URL, temporary_settings
from test_pipeline import ROOT, TINY, children, read_session

from examples.drive import DRIVE
from examples.record import record
from flows.diagnose import diagnose_folder
from simgap.formats.arrays import load_arrays
from simgap.formats.documents import read_json, write_json
from simgap.types import SimgapError
from tasks import diagnose
from tasks.params import load_params
from tasks.workspace import Cell, Share, Workspace

DIAGNOSED = ("sim_model_diagnosed", "sim_fsvgd_diagnosed", "residual_diagnosed")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person's folder: recordings of a drive with friction, and `mine.py`, a simulator."""
    folder = tmp_path_factory.mktemp("person")
    record("drive", folder / "rail", sessions=3, seconds=20.0, seed=0)
    (folder / "mine.py").write_text("from examples.drive import DRIVE\n")
    return folder


@pytest.fixture(scope="module")
def run_id(folder: Path, prefect_server: dict[str, str]) -> Iterator[str]:
    """A diagnosis as the form starts it; gives its run in MLflow."""
    served = temporary_settings({PREFECT_API_URL: prefect_server["PREFECT_API_URL"]})
    with pytest.MonkeyPatch.context() as patch, served:
        patch.chdir(folder)
        patch.syspath_prepend(str(folder))
        yield diagnose_folder(Path("rail"), "mine:DRIVE", None, None, Path("found"))
    for name in ("mine", "own_mine"):
        sys.modules.pop(name, None)


@pytest.mark.long
def test_the_diagnosis_is_a_run_in_mlflow(folder: Path, run_id: str) -> None:
    client = MlflowClient(f"sqlite:///{folder / 'mlflow.db'}")
    experiment = client.get_experiment_by_name("diagnosis")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.run_id == run_id
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
    assert {"nominal/nll_1", "refitted/nll_1", "black_box/nll_1"} <= set(scores)
    assert run.data.metrics == pytest.approx(
        {**scores, "effects": len(found["effects"]), "seconds": run.data.metrics["seconds"]}
    )
    logged = {file.path for file in client.list_artifacts(run.info.run_id)}
    assert logged == {path.name for path in (folder / "found").iterdir() if path.name != ".lock"}
    assert {"diagnosis.json", "diagnosis.html", "augmented.npz"} <= logged


@pytest.mark.long
@pytest.mark.usefixtures("run_id")
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
    at_rest = {"position": 0.1, "velocity": 0.2}
    forces = [(0.0, 1.0), (0.02, 1.5), (0.04, 2.0)]
    got = model.predict(pd.DataFrame([{"time_s": t, **at_rest, "cmd_force": force} for t, force in forces]))[2:]
    assert list(got.columns) == ["next_position", "next_velocity"]
    found = load_arrays(folder / "found" / "augmented.npz")
    if not found["theta"].any():  # nothing was found in these few rows: it is the simulator itself
        expected = DRIVE.step(found["phi"], np.array([0.1, 0.2], np.float32), np.array([2.0], np.float32))
        np.testing.assert_allclose(got.to_numpy()[0], expected, rtol=1e-5)
    assert np.isfinite(got.to_numpy()).all()


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
    folder: Path, monkeypatch: pytest.MonkeyPatch, given: dict[str, Any], words: str
) -> None:
    """In the flow, which Prefect's form starts too."""
    monkeypatch.chdir(folder)
    right = {"recordings": Path("rail"), "simulator": "examples.drive:DRIVE", "baseline": None, "heldout": None}
    with pytest.raises(SimgapError, match=words):
        diagnose_folder(**{**right, "out": Path("unused"), **given})
    assert not (folder / "unused").exists()


@pytest.mark.long
def test_models_that_are_given_a_diagnosis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, prefect_server: dict[str, str]
) -> None:
    """One diagnosis serves both; where the recordings are too few, cells fail, are named and lose no other."""
    train = {**TINY["train"], "models": ["sim_model", *DIAGNOSED], "sample_sizes": [80, 100_000]}
    policy = {**TINY["policy"], "models": ["residual_diagnosed"], "sample_sizes": [80, 100_000]}
    overrides = {**TINY, "train": train, "policy": policy}
    workspace = Workspace(tmp_path, "virtual")
    stale = workspace.record(Cell("student_t", "sim_model", 100_000, 0))
    write_json(stale, {"fingerprint": "of other parameters"})
    params = load_params(ROOT / "params.yaml", overrides).model_dump(mode="json")
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    stages = ("recordings", "transitions", "train", "score", "report", "policy")
    with (tmp_path / "output.txt").open("w") as printed, worker(prefect_server, stages, printed) as work:
        statuses = {stage: work(tmp_path, f"{stage} virtual") for stage in stages}
    output = (tmp_path / "output.txt").read_text()
    assert {stage for stage, status in statuses.items() if status} == {"train", "policy"}, output
    assert "4 of 8 cells failed" in output
    assert "1 of 2 policies failed" in output
    assert "N = 100000 transitions are asked for" in output
    assert pd.read_csv(workspace.reports / "scores.csv")["sample_size"].tolist() == [80, 80, 80, 80]
    assert not stale.exists()
    assert {p.stem for p in workspace.models.glob("diagnosis-*")} == {"diagnosis-N80-s0"}
    found = read_json(workspace.effects(Share(80, 0)))["effects"]

    runs = children(tmp_path).set_index("name")
    for model in DIAGNOSED:
        run = runs.loc[Cell("student_t", model, 80, 0).name]
        assert (run["diagnosis"], run["effects"]) == ("diagnosis-N80-s0", ", ".join(found) or "none")
        assert np.isfinite(run["nll"])
        assert run["prefect_flow_run"]
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path / 'mlflow.db'}")
    run_id = runs.loc[Cell("student_t", "sim_model_diagnosed", 80, 0).name, "id"]
    predicted = mlflow.pyfunc.load_model(f"runs:/{run_id}/model").predict(read_session(workspace))
    assert np.isfinite(predicted[2:].to_numpy()).all()

    report = (workspace.reports / "report.md").read_text()
    assert f"N = 80: {', '.join(found) or 'none'} (seed 0)" in report
    assert "SIM-MODEL + diagnosed: **level at 1** of 1 N against SIM-MODEL" in report
