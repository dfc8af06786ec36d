"""Every stage killed with SIGKILL while it writes, and started again: as if nothing had been."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from mlflow import MlflowClient
from test_pipeline import ROOT, TINY

from tasks.params import load_params

WORKER = """
import os, signal, sys
import flows
from flows import diagnose, policy, recordings, report, score, track, train, transitions
from flows.start import main

def work(folder, stages, writes):
    os.chdir(folder)
    replace, left = os.replace, writes
    for i, name in enumerate(stages):
        def replaced(*paths, last=i == len(stages) - 1):
            nonlocal left
            left -= last
            if last and left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            replace(*paths)
        os.replace = replaced
        sys.argv = [name, "virtual"]
        main(globals()[name].run)

for line in sys.stdin:
    folder, writes, *stages = line.split()
    child = os.fork()  # nothing has run here yet, so that a fork is safe, and spares the seconds of imports
    if not child:
        os.dup2(2, 1)
        work(folder, stages, int(writes))
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
WRITES = {"recordings": 2, "transitions": 2, "train": 4, "score": 1, "report": 3, "policy": 3, "track": 4}
"""By stage, at which of its writes it is killed: with something written already, where it writes several."""
ONE: dict[str, Any] = {"models": ["sim_model"], "sample_sizes": [40], "seeds": [0, 1]}

Work = Callable[..., int]


@pytest.fixture(scope="module")
def work(prefect_server: dict[str, str]) -> Iterator[Work]:
    """Runs stages in a folder, in a process of their own, and kills it at a write of the last; gives its status."""
    environment = {**prefect_server, "PYTHONPATH": str(ROOT)}
    worker = subprocess.Popen([sys.executable, "-c", WORKER], env=environment, stdin=subprocess.PIPE,
                              stdout=subprocess.PIPE, text=True)  # fmt: skip
    assert worker.stdin is not None
    assert worker.stdout is not None
    stdin, stdout = worker.stdin, worker.stdout

    def run(folder: Path, *stages: str, writes: int = 0) -> int:
        print(folder, writes, *stages, file=stdin, flush=True)
        return int(stdout.readline())

    yield run
    stdin.close()
    assert worker.wait(60) == 0


def place(folder: Path) -> Path:
    """A folder with tiny parameters."""
    train = {**TINY["train"], **ONE, "workers": 1}
    policy = {**TINY["policy"], **ONE, "seeds": [0]}
    params = load_params(ROOT / "params.yaml", {**TINY, "train": train, "policy": policy}).model_dump(mode="json")
    folder.mkdir()
    (folder / "params.yaml").write_text(yaml.safe_dump(params))
    return folder


def results(folder: Path) -> dict[str, Any]:
    """What a folder holds by path: arrays and recordings as they are, scores without the seconds they took."""
    found: dict[str, Any] = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and "mlruns" not in p.parts):
        name = path.relative_to(folder).as_posix()
        if path.suffix in (".npz", ".parquet"):
            found[name] = path.read_bytes()
        elif name.startswith("scores/"):
            found[name] = [
                {k: v for k, v in row.items() if k != "seconds"} for row in json.loads(path.read_text())["cells"]
            ]
        elif name.split("/")[0] in ("models", "policies", "reports"):
            found[name] = None  # times are in it
    return found


def test_every_stage_killed_midway_ends_as_if_it_had_not_been(work: Work, tmp_path: Path) -> None:
    stages, whole, killed = list(WRITES), place(tmp_path / "whole"), place(tmp_path / "killed")
    assert work(whole, *stages) == 0
    for before, stage in zip([None, *stages], stages, strict=False):
        first = [before] if before else []
        assert work(killed, *first, stage, writes=WRITES[stage]) == -9, stage
    assert work(killed, stages[-1]) == 0
    wanted, found = results(whole), results(killed)
    assert list(found) == list(wanted)
    assert [name for name in wanted if found[name] != wanted[name]] == []
    assert not list(killed.rglob(".*.tmp"))
    client = MlflowClient(f"sqlite:///{killed / 'mlflow.db'}")
    runs = client.search_runs([e.experiment_id for e in client.search_experiments()])
    assert {run.info.status for run in runs} == {"FINISHED", "KILLED"}
