"""The stage `train` on a Dask cluster of two processes, one of which is killed while it trains."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
import yaml
from test_pipeline import ROOT, TINY, children

from tasks.params import load_params
from tasks.train import grid
from tasks.workspace import Workspace

TRAIN = {"models": ["sim_model"], "sample_sizes": [40], "seeds": [0, 1, 2, 3],
         "sim_model": {"training_steps": 200_000, "evaluate_every": 100}}  # fmt: skip


def workers(process: subprocess.Popen[bytes]) -> list[psutil.Process]:
    """The cluster's processes: those that Python's multiprocessing spawned, but for its own helper."""
    return [p for p in psutil.Process(process.pid).children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]


def test_a_killed_worker_is_replaced_and_its_cell_begun_again(tmp_path: Path, prefect_server: dict[str, str]) -> None:
    params: dict[str, Any] = {**TINY, "train": {**TINY["train"], **TRAIN}}
    whole = load_params(ROOT / "params.yaml", params).model_dump(mode="json")
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(whole))
    environment = {**prefect_server, "PYTHONPATH": str(ROOT)}
    for stage in ("recordings", "transitions"):
        subprocess.run([sys.executable, "-m", f"flows.{stage}", "virtual"], cwd=tmp_path, env=environment, check=True)
    workspace, cells = Workspace(tmp_path, "virtual"), grid(load_params(tmp_path / "params.yaml").train)
    with (tmp_path / "output.txt").open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "flows.train", "virtual"], cwd=tmp_path, stdout=output, stderr=subprocess.STDOUT,
            env={**environment, "SIMGAP_CLUSTER": "2"},
        )  # fmt: skip
    said = lambda: (tmp_path / "output.txt").read_text()  # noqa: E731
    while not any(workspace.record(cell).exists() for cell in cells):  # both are at their second cell soon
        assert process.poll() is None, said()
        time.sleep(0.1)
    listening = {c.laddr.ip for p in [psutil.Process(process.pid), *workers(process)] for c in p.net_connections()
                 if c.status == psutil.CONN_LISTEN}  # fmt: skip
    assert listening == {"127.0.0.1"}
    victim, other = workers(process)
    os.kill(victim.pid, signal.SIGKILL)
    assert process.wait(timeout=400) == 0, said()
    assert all(workspace.record(cell).exists() for cell in cells)
    runs = children(tmp_path)
    finished = runs[runs["status"] == "FINISHED"]
    assert sorted(finished["name"]) == sorted(cell.name for cell in cells)
    pids = set(finished["simgap.pid"].astype(int))
    assert process.pid not in pids
    assert len(pids) <= 3, "a process for every worker and the one that replaced the victim, not one for every cell"
    assert other.pid in pids
    assert json.loads(workspace.record(cells[0]).read_text())["steps"] == 200_000
