"""The pipeline at a tiny size, as a person runs it: whole, with a failing cell, killed halfway and started again."""

import html
import json
import os
import re
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mlflow
import numpy as np
import pandas as pd
import pytest
import yaml
from drawn import drawn
from given import POLICY_SIZES, TRAINING_SIZES
from mlflow import MlflowClient

from simgap import scores
from simgap.formats.documents import read_json
from simgap.simulators.spot import SCHEMA
from tasks import recordings, transitions
from tasks.files.models import load_model
from tasks.params import Params, VirtualParams, load_params
from tasks.policy import input_columns as input_columns_of_policies
from tasks.workspace import SPLITS, Cell, Workspace

ROOT = Path(__file__).parents[2]
TINY: dict[str, Any] = {
    # Short: what a diagnosis of them says has tests of its own. Yet it is searched, which takes a minute or two.
    "recordings": {"virtual": {"training_sessions": 4, "test_sessions": 1, "session_s": 1.6}},
    "train": {
        "models": ["sim_model", "fsvgd", "sim_fsvgd"],
        "noises": ["student_t"],
        "sample_sizes": [40, 80],
        "seeds": [0],
        **TRAINING_SIZES,
    },
    "score": {"horizons": [5, 10]},
    "policy": {
        "noise": "student_t",
        "models": ["sim_model", "sim_fsvgd"],
        "sample_sizes": [80],
        "seeds": [0],
        **POLICY_SIZES,
    },
    "track": {"ellipse": {"rounds": 0.3}, "helix": {"turns": 0.5}, "proportional": {"gains": [1.0, 2.0]}},
}  # fmt: skip
MODELS, SIZES = ("sim_model", "fsvgd", "sim_fsvgd"), (40, 80)
CELLS = [Cell("student_t", model, n, 0) for n in SIZES for model in MODELS]
SIM_MODEL_STEPS = 100
SWEEP = ("flows.sweep", "virtual", "--name", "w")


def start(
    folder: Path, overrides: dict[str, Any], environment: Mapping[str, str] = os.environ
) -> subprocess.Popen[bytes]:
    """`make run`'s command in a folder of its own."""
    folder.mkdir(exist_ok=True)
    (folder / "params.yaml").write_text((ROOT / "params.yaml").read_text())
    (folder / "overrides.yaml").write_text(yaml.safe_dump(overrides))
    command = ("flows.reproduce", "virtual", "--overrides", "overrides.yaml", "--workspace", "w")
    return launch(folder, command, environment)


def launch(folder: Path, command: Sequence[str], environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """A command in a folder that holds its parameters, its MLflow store and what is printed.

    A process group of its own: killed with SIGKILL, a run leaves what it started. Not a session of its own: Linux
    shares the processor among sessions, whatever the priority of their processes.
    """
    environment = {**environment, "PYTHONPATH": str(ROOT)}
    with (folder / "output.txt").open("wb") as output:
        return subprocess.Popen([sys.executable, "-m", *command], cwd=folder, env=environment, stdout=output,
                                stderr=subprocess.STDOUT, process_group=0)  # fmt: skip


def prepare(workspace: Workspace, params: Params) -> None:
    """Recordings of the virtual robot and their transitions, without a flow."""
    source, step = params.source("virtual"), 1 / params.transitions.nominal_rate_hz
    assert isinstance(source, VirtualParams)
    recordings.record_virtual.fn(workspace, source)
    for split in SPLITS:
        transitions.prepare.fn(workspace, split, step)


def finish(process: subprocess.Popen[bytes], folder: Path) -> tuple[int, str]:
    """Exit status and what was printed."""
    status = process.wait(timeout=1200)
    return status, (folder / "output.txt").read_text()


def children(folder: Path, experiment_name: str = "model-validation") -> pd.DataFrame:
    """The cells' runs of an experiment in MLflow, oldest first."""
    client = MlflowClient(f"sqlite:///{folder / 'mlflow.db'}")
    experiment = client.get_experiment_by_name(experiment_name)
    assert experiment is not None
    runs = client.search_runs([experiment.experiment_id], order_by=["start_time ASC"])
    rows = [
        {"name": r.info.run_name, "id": r.info.run_id, "status": r.info.status, **r.data.tags, **r.data.metrics}
        for r in runs
        if "mlflow.parentRunId" in r.data.tags
    ]
    return pd.DataFrame(rows)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A finished run's folder and what it printed."""
    folder = tmp_path_factory.mktemp("pipeline")
    longer = {"sim_model": {"training_steps": SIM_MODEL_STEPS, "evaluate_every": SIM_MODEL_STEPS // 2}}
    overrides = {**TINY, "train": {**TINY["train"], **longer}}
    status, output = finish(start(folder, overrides, {**os.environ, "PREFECT_HOME": str(folder / "home")}), folder)
    assert status == 0, output
    return folder, output


def test_a_run_without_a_prefect_server_starts_none(finished: tuple[Path, str]) -> None:
    assert not list((finished[0] / "home").glob("prefect.db*"))


def test_a_run_ends_by_saying_where_things_are(finished: tuple[Path, str]) -> None:
    folder, output = finished
    tail = output.strip().splitlines()[-5:]
    assert [line.split()[0] for line in tail] == ["report", "figures", "tracking", "diagnosis", "MLflow"]
    report = folder / tail[0].split()[1]
    assert "Sim-FSVGD" in report.read_text()
    assert drawn(report.parent / "nll_against_n.png")
    statement = read_json(report.parent / "diagnosis" / "diagnosis.json")["statement"]
    assert statement in output
    assert html.escape(statement) in (folder / tail[3].split()[1]).read_text()
    assert "Error encountered" not in output
    assert " INFO " not in output
    assert "Traceback" not in output


def test_tables_and_metrics_hold_every_cell(finished: tuple[Path, str]) -> None:
    reports = finished[0] / "w" / "reports" / "virtual"
    table = pd.read_csv(reports / "scores.csv")
    assert len(table) == len(CELLS)
    validated = table["model"] != "sim_model"
    assert np.isfinite(table[validated].select_dtypes("number").to_numpy()).all()
    assert np.isfinite(table.drop(columns="validation_nll").select_dtypes("number").to_numpy()).all()
    metrics = json.loads((reports / "metrics.json").read_text())
    assert set(metrics) == {f"nll_{model}" for model in MODELS}
    largest = table[table["sample_size"] == 80]
    assert metrics["nll_fsvgd"] == pytest.approx(
        largest[largest["model"] == "fsvgd"].groupby("noise")["nll"].mean().min(),
        rel=1e-5,  # the table has 6 digits
    )


def test_every_cell_is_a_run_with_curve_data_set_scores_and_model(finished: tuple[Path, str]) -> None:
    folder, _ = finished
    runs = children(folder)
    assert sorted(runs["name"]) == sorted(cell.name for cell in CELLS)
    assert (runs["status"] == "FINISHED").all()
    table = pd.read_csv(folder / "w" / "reports" / "virtual" / "scores.csv")
    client = MlflowClient(f"sqlite:///{folder / 'mlflow.db'}")
    for row in table.itertuples():
        name = Cell(row.noise, row.model, row.sample_size, row.seed).name
        run = client.get_run(runs.set_index("name").loc[name, "id"])
        assert run.data.metrics["nll"] == pytest.approx(row.nll, rel=1e-4)
        assert run.data.metrics["training_seconds"] > 0
        assert run.data.params["sample_size"] == str(row.sample_size)
        assert run.inputs.dataset_inputs[0].dataset.digest
        assert {"fingerprint", "transitions", "source"} <= set(run.data.tags)
        curve = client.get_metric_history(run.info.run_id, "training/train_nll")
        steps = SIM_MODEL_STEPS if row.model == "sim_model" else TRAINING_SIZES["bnn"]["max_training_steps"]
        assert curve[-1].step == steps
        assert len(curve) == 1 + (row.model == "sim_model")


def read_session(workspace: Workspace) -> pd.DataFrame:
    """The first of the sessions to judge by, as it was recorded."""
    return pd.read_parquet(min((workspace.recordings / "test").glob("*.parquet")))


def test_a_logged_model_loads_and_predicts(finished: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    folder, _ = finished
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{folder / 'mlflow.db'}")
    workspace = Workspace(folder / "w", "virtual")
    test = transitions.load(workspace, "test")
    session = read_session(workspace).head(23)  # 20 transitions with the commands before them
    for cell in CELLS[-3:]:
        run_id = children(folder).set_index("name").loc[cell.name, "id"]
        loaded = mlflow.pyfunc.load_model(f"runs:/{run_id}/model")
        table = loaded.predict(session)
        assert (len(table), table.head(2).isna().all(axis=None)) == (23, True)
        table = table[2:-1]
        residual = test.y[:20] - table[[f"mean_{name}" for name in SCHEMA.encoded]].to_numpy()
        ours = scores.one_step(load_model(workspace.model(cell)), test._replace(x=test.x[:20], y=test.y[:20]),
                               SCHEMA.encoded)  # fmt: skip
        assert np.sqrt(np.mean(residual[:, 0] ** 2)) == pytest.approx(ours["rmse_base_x"], rel=1e-3)
        assert (table[[f"std_{name}" for name in SCHEMA.encoded]].to_numpy() > 0).all()


@pytest.mark.long
def test_a_run_killed_halfway_resumes_and_repeats_no_finished_cell(tmp_path: Path) -> None:
    """A sweep, which trains and scores and does nothing besides; `test_killed` has every stage."""
    train = {**TINY["train"], "models": ["sim_model"], "sample_sizes": [40], "seeds": [*range(len(CELLS))]}
    params = load_params(ROOT / "params.yaml", {**TINY, "train": train}).model_dump(mode="json")
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    process = launch(tmp_path, SWEEP, os.environ)
    models = tmp_path / "sweeps" / "w" / "models" / "virtual"
    deadline = time.monotonic() + 300
    while len(list(models.glob("*.json"))) < 2 and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = {path.name: path.stat().st_mtime_ns for path in models.glob("*.json")}
    assert 2 <= len(before) < len(CELLS), "the run was to be killed with some cells done and some not"

    status, output = finish(launch(tmp_path, SWEEP, os.environ), tmp_path)
    assert status == 0, output
    after = {path.name: path.stat().st_mtime_ns for path in models.glob("*.json")}
    assert len(after) == len(CELLS)
    assert {name: after[name] for name in before} == before
    runs = children(tmp_path)
    latest = runs[runs["mlflow.parentRunId"] == runs["mlflow.parentRunId"].iloc[-1]]
    assert sorted(f"{name}.json" for name in latest.loc[latest["reused"] == "True", "name"]) == sorted(before)
    assert set(latest["status"]) == {"FINISHED"}
    assert set(runs["status"]) <= {"FINISHED", "KILLED"}, "none is left running"
    client = MlflowClient(f"sqlite:///{tmp_path / 'mlflow.db'}")
    grids = [r.info.status for r in client.search_runs(["1"]) if "mlflow.parentRunId" not in r.data.tags]
    assert sorted(grids) == ["FINISHED", "KILLED"]


def test_policies_are_learnt_run_on_the_robot_and_told_of(
    finished: tuple[Path, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, _ = finished
    tracking = Workspace(folder / "w", "virtual").tracking
    errors = pd.read_csv(tracking / "errors.csv")
    assert set(errors["shape"]) == {"ellipse", "helix"}
    assert set(errors["policy"]) == {"sim_model", "sim_fsvgd", "proportional 1 per s", "proportional 2 per s"}
    assert (errors["mean_error"] > 0).all()
    report = (tracking / "report.md").read_text()
    assert "Best policy against proportional 1 per s" in report
    assert "Sim-FSVGD below SIM-MODEL at every N" in report
    for name in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", report):
        assert drawn(tracking / name), name

    runs = children(folder, "policies").set_index("name")
    run = runs.loc[Cell("student_t", "sim_fsvgd", 80, 0).name]
    row = errors[(errors["policy"] == "sim_fsvgd") & (errors["shape"] == "helix")].iloc[0]
    assert run["helix/mean_error"] == pytest.approx(row["mean_error"], rel=1e-4)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{folder / 'mlflow.db'}")
    table = pd.DataFrame(np.zeros((2, 27)), columns=list(input_columns_of_policies()))
    commands = mlflow.pyfunc.load_model(f"runs:/{run['id']}/model").predict(table)
    assert commands.shape == (2, 6)
    client = MlflowClient(f"sqlite:///{folder / 'mlflow.db'}")
    assert len(client.get_metric_history(run["id"], "training/return")) == POLICY_SIZES["learning"]["evaluations"]


@pytest.mark.parametrize(
    ("arguments", "overrides", "words"),
    [
        (["nowhere"], "{}", ["recordings.nowhere", "virtual", "spot"]),
        (["virtual"], "train: {bnn: {particels: 5}}", ["train.bnn", "particels", "particles"]),
        (["virtual"], "train: {seeds: [-1]}", ["train.seeds.0"]),
        (["spot", "--recordings", "empty"], "{}", ["empty"]),
    ],
)
def test_wrong_input_is_explained_without_a_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
    arguments: list[str], overrides: str, words: list[str],
) -> None:  # fmt: skip
    """As `python -m` does it, but in this process: of another one, all time would be its imports."""
    (tmp_path / "params.yaml").write_text((ROOT / "params.yaml").read_text())
    (tmp_path / "o.yaml").write_text(overrides)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["reproduce", *arguments, "--overrides", "o.yaml", "--workspace", "w"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("flows.reproduce", run_name="__main__")
    output = "".join(capfd.readouterr())
    assert ended.value.code == 1
    assert all(word in output for word in words), output
    assert "Traceback" not in output
