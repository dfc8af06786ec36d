"""The stage `train` on a Dask cluster of two processes, one of which is killed while it trains."""

import os
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from test_pipeline import ROOT, TINY, children, prepare

from flows import train
from simgap.formats.documents import read_json
from tasks.params import load_params
from tasks.train import grid
from tasks.workspace import Workspace

STEPS = 25_000
TRAIN = {"models": ["sim_model"], "sample_sizes": [40], "seeds": [0, 1, 2, 3],
         "sim_model": {"training_steps": STEPS, "evaluate_every": 100}}  # fmt: skip


def workers() -> list[psutil.Process]:
    """The cluster's processes: those that Python's multiprocessing spawned, but for its own helper."""
    there = []
    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # ended since it was listed
            if "spawn_main" in " ".join(process.cmdline()):
                there.append(process)
    return there


@pytest.mark.long
def test_a_killed_worker_is_replaced_and_its_cell_begun_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    overrides: dict[str, Any] = {**TINY, "train": {**TINY["train"], **TRAIN}}
    params, workspace = load_params(ROOT / "params.yaml", overrides), Workspace(Path(), "virtual")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIMGAP_CLUSTER", "2")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    prepare(workspace, params)
    records = [workspace.record(cell).absolute() for cell in grid(params.train)]
    seen: dict[str, Any] = {}

    def kill_one() -> None:
        while not any(record.exists() for record in records):  # both are at work, or at their second cell
            time.sleep(0.05)
        there = workers()
        seen["addresses"] = {c.laddr.ip for p in there for c in p.net_connections() if c.status == psutil.CONN_LISTEN}
        seen["pids"] = [p.pid for p in there]
        os.kill(there[0].pid, signal.SIGKILL)
        # Looked for while the other is at work: a quick one leaves its successor no cell to be known by.
        while not (new := {p.pid for p in workers()} - set(seen["pids"])):
            time.sleep(0.02)
        seen["successor"] = new.pop()

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    train.run("virtual", params, Path())
    killer.join(10)
    assert seen["addresses"] == {"127.0.0.1"}
    assert [read_json(record)["steps"] for record in records] == 4 * [STEPS]
    runs = children(tmp_path)
    finished = runs[runs["status"] == "FINISHED"]
    assert sorted(finished["name"]) == sorted(cell.name for cell in grid(params.train))
    pids = set(finished["simgap.pid"].astype(int))
    assert seen["pids"][1] in pids
    assert pids <= {*seen["pids"], seen["successor"]}
    assert not workers()
