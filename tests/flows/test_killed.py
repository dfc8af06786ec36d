"""Every stage killed with SIGKILL while it writes, and started again: as if nothing had been.

Diagnoses and sealed stages, which take longest, are killed in `test_diagnose_stage` and `test_sealed_suite`.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from killing import Work, worker
from mlflow import MlflowClient
from test_pipeline import ROOT, TINY

from tasks.params import load_params

WRITES = {"recordings": 2, "transitions": 2, "train": 4, "score": 1, "report": 3, "policy": 3, "track": 4}
"""By stage, at which of its writes it is killed: with something written already, where it writes several."""
ONE: dict[str, Any] = {"models": ["sim_model"], "sample_sizes": [40], "seeds": [0, 1]}


@pytest.fixture(scope="module")
def work() -> Iterator[Work]:
    with worker(os.environ, list(WRITES)) as work:
        yield work


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


@pytest.mark.long
def test_every_stage_killed_midway_ends_as_if_it_had_not_been(work: Work, tmp_path: Path) -> None:
    commands, whole, killed = [f"{s} virtual" for s in WRITES], place(tmp_path / "whole"), place(tmp_path / "killed")
    assert work(whole, *commands) == 0
    for before, command, writes in zip([None, *commands], commands, WRITES.values(), strict=False):
        first = [before] if before else []
        assert work(killed, *first, command, writes=writes) == -9, command
    assert work(killed, commands[-1]) == 0
    wanted, found = results(whole), results(killed)
    assert list(found) == list(wanted)
    assert [name for name in wanted if found[name] != wanted[name]] == []
    assert not list(killed.rglob(".*.tmp"))
    client = MlflowClient(f"sqlite:///{killed / 'mlflow.db'}")
    runs = client.search_runs([e.experiment_id for e in client.search_experiments()])
    assert {run.info.status for run in runs} == {"FINISHED", "KILLED"}
