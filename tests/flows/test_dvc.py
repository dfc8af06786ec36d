"""`dvc repro` in a copy of the project at a tiny size: whole once, nothing the second time, sweeps leave no trace."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from test_pipeline import TINY

from tasks.params import load_params

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkout of the project's files with tiny parameters and a DVC cache of its own."""
    folder = tmp_path_factory.mktemp("dvc") / "project"
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True)
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file() and not name.startswith(("reports/", "dvc.lock", "spot/dvc.lock")):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    one: dict[str, Any] = {"models": ["sim_model"], "sample_sizes": [40]}
    tiny = {**TINY, "train": {**TINY["train"], **one}, "policy": {**TINY["policy"], **one}}
    params = load_params(ROOT / "params.yaml", tiny).model_dump(mode="json")
    (folder / "params.yaml").write_text(yaml.safe_dump(params))
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    subprocess.run(["git", "add", "-A"], cwd=folder, check=True)
    return folder


def run(folder: Path, *command: str) -> str:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_repro_makes_everything_once_and_sweeps_leave_it_alone(copy: Path) -> None:
    run(copy, "dvc", "repro")
    assert (copy / "dvc.lock").exists()
    assert (copy / "reports" / "virtual" / "report.md").exists()
    assert (copy / "reports" / "virtual" / "diagnosis" / "diagnosis.json").exists()
    assert (copy / "reports" / "virtual" / "tracking" / "report.md").exists()
    assert "up to date" in run(copy, "dvc", "repro")

    before = run(copy, "dvc", "status", "--json")
    (copy / "more.yaml").write_text("{train: {seeds: [1]}, policy: {seeds: [1]}}\n")
    run(copy, "python", "-m", "flows.reproduce", "virtual", "--overrides", "more.yaml", "--workspace", "sweeps/more")
    assert run(copy, "dvc", "status", "--json") == before

    metrics = run(copy, "dvc", "metrics", "show", "--json")
    assert "sim_model" in metrics
    assert "nll" in metrics


def test_the_real_spots_pipeline_is_complete(copy: Path) -> None:
    """Without the recordings its stages are there to be listed, and say which folder is missing."""
    stages = run(copy, "dvc", "stage", "list", "spot/dvc.yaml")
    assert [line.split()[0] for line in stages.splitlines()] == [
        f"spot/dvc.yaml:{stage}"
        for stage in ("recordings", "transitions", "train", "score", "report", "policy", "track", "diagnose")
    ]
