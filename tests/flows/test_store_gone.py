"""MLflow's server gone while a grid is trained, and back again: what was trained is logged, and not trained anew."""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from conftest import free_port, until_it_answers
from mlflow import MlflowClient
from test_pipeline import ROOT, TINY, prepare

from flows import train
from simgap.types import SimgapError
from tasks.params import load_params
from tasks.train import grid
from tasks.workspace import Workspace

TRAIN = {"models": ["sim_model"], "sample_sizes": [40], "seeds": [0, 1], "workers": 1}


def served(port: int) -> subprocess.Popen[bytes]:
    """MLflow's server in this folder, when it answers."""
    server = subprocess.Popen(
        [Path(sys.executable).parent / "mlflow", "server", "--port", str(port), "--workers", "1",
         "--backend-store-uri", "sqlite:///served.db", "--artifacts-destination", "served"],
        env={**os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}, stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    until_it_answers(server, f"http://127.0.0.1:{port}/health")
    return server


def kill(server: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(server.pid, signal.SIGKILL)
    server.wait()


@pytest.mark.long
def test_what_was_trained_while_the_server_was_gone_is_logged_when_it_is_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    overrides: dict[str, Any] = {**TINY, "train": {**TINY["train"], **TRAIN}}
    params, workspace = load_params(ROOT / "params.yaml", overrides), Workspace(Path(), "virtual")
    port = free_port()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://127.0.0.1:{port}")
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    prepare(workspace, params)
    first, *_ = records = [workspace.record(cell) for cell in grid(params.train)]
    server, replace = served(port), os.replace

    def replaced(source: Path, target: Path) -> None:
        replace(source, target)
        if Path(target) == first:
            kill(server)

    monkeypatch.setattr(os, "replace", replaced)
    try:
        with pytest.raises(SimgapError, match=f"2 of 2 cells failed(.|\n)*127.0.0.1:{port} refused"):
            train.run("virtual", params, Path())
        trained = [record.stat().st_mtime_ns for record in records]
        server = served(port)
        train.run("virtual", params, Path())
        assert [record.stat().st_mtime_ns for record in records] == trained
        client = MlflowClient(f"http://127.0.0.1:{port}")
        runs = client.search_runs(["1"], "attributes.status = 'FINISHED' and tags.reused = 'True'")
        assert sorted(str(run.info.run_name) for run in runs) == sorted(cell.name for cell in grid(params.train))
        assert all(run.outputs is not None and run.outputs.model_outputs for run in runs)
    finally:
        kill(server)
