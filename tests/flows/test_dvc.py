"""`dvc repro` in a copy of the project at a tiny size: whole once, nothing the second time, sweeps leave no trace."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from test_pipeline import TINY

from flows import provenance
from tasks.params import load_params
from tasks.workspace import Workspace

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkout of the project's files with tiny parameters and a DVC cache of its own."""
    folder = tmp_path_factory.mktemp("dvc") / "project"
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True)
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file() and not name.startswith(("reports/", "dvc.lock", "pipelines/spot/dvc.lock")):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    one: dict[str, Any] = {"models": ["sim_model"], "sample_sizes": [40]}
    tiny = {**TINY, "train": {**TINY["train"], **one}, "policy": {**TINY["policy"], **one}}
    params = load_params(ROOT / "params.yaml", tiny).model_dump(mode="json")
    (folder / "params.yaml").write_text(yaml.safe_dump(params))
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    subprocess.run(["git", "add", "-A"], cwd=folder, check=True)
    author = ("-c", "user.name=test", "-c", "user.email=test@localhost")
    subprocess.run(["git", *author, "commit", "-qm", "as it is"], cwd=folder, check=True)
    return folder


@pytest.fixture(scope="module")
def run(copy: Path) -> Callable[..., str]:
    """Runs a command in the copy; gives what it prints."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(copy)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # compiled Python lies in the folders that stages depend on

    def ran(*command: str) -> str:
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return ran


def test_repro_makes_everything_once_and_sweeps_leave_it_alone(copy: Path, run: Callable[..., str]) -> None:
    run("dvc", "repro")
    assert (copy / "dvc.lock").exists()
    assert (copy / "reports" / "virtual" / "report.md").exists()
    assert (copy / "reports" / "virtual" / "diagnosis" / "diagnosis.json").exists()
    assert (copy / "reports" / "virtual" / "tracking" / "report.md").exists()
    assert "up to date" in run("dvc", "repro")

    before = run("dvc", "status", "--json")
    run("python", "-m", "flows.sweep", "--name", "more", "--seeds", "1", "--try", "sim_model.weight_decay=0,0.01")
    assert len((copy / "sweeps" / "more" / "results.csv").read_text().splitlines()) == 1 + 2
    assert run("dvc", "status", "--json") == before

    metrics = run("dvc", "metrics", "show", "--json")
    assert "nll_sim_model" in metrics
    assert "nll_sim_model" in run("dvc", "metrics", "diff", "--all", "--json")


def test_a_remote_gives_a_clone_what_git_does_not_hold(copy: Path, run: Callable[..., str], tmp_path: Path) -> None:
    """As how_to/reproduce.md says: without one there are reports and metrics, after `dvc pull` the data too."""
    assert (copy / "dvc.lock").exists()
    run("git", "add", "-A")
    run("git", "-c", "user.name=test", "-c", "user.email=test@localhost", "commit", "-qm", "with its results")
    clone, there, remote = (
        tmp_path / "clone",
        ("--cd", str(tmp_path / "clone")),
        ("-d", "store", str(tmp_path / "store")),
    )
    run("git", "clone", "-q", ".", str(clone))
    assert (clone / "reports" / "virtual" / "report.md").exists()
    assert any((clone / "policies" / "virtual").iterdir())
    assert "nll_sim_model" in run("dvc", *there, "metrics", "show")
    run("dvc", *there, "pull", "--allow-missing")
    assert not list((clone / "models").rglob("*.npz"))

    run("dvc", "remote", "add", *remote)
    run("dvc", "push")
    run("dvc", *there, "remote", "add", *remote)
    run("dvc", *there, "pull", "--allow-missing")
    for folder in ("data/virtual/recordings", "data/virtual/transitions", "models/virtual", "scores/virtual", "tracks"):
        assert any((clone / folder).iterdir()), folder
    assert "up to date" in run("dvc", *there, "status", "dvc.yaml")


def test_an_experiment_changes_what_a_sweep_may_change(copy: Path, run: Callable[..., str]) -> None:
    """Of DVC, on the stages before it that are there already."""
    changed = ("train.seeds=[1]", "train.sim_model.learning_rate=0.01", "train.models=[sim_model]")
    run("dvc", "exp", "run", "--name", "other", *(part for change in changed for part in ("-S", change)), "train")
    assert [path.name for path in (copy / "models" / "virtual").glob("*.npz")] == ["sim_model-student_t-N40-s1.npz"]
    assert "other" in run("dvc", "exp", "list", "--name-only")
    assert (
        json.loads(run("dvc", "params", "diff", "--json"))["params.yaml"]["train.sim_model.learning_rate"]["new"]
        == 0.01
    )


def test_the_real_spots_pipeline_is_complete(run: Callable[..., str]) -> None:
    """Without the recordings its stages are there to be listed, and say which folder is missing."""
    stages = run("dvc", "stage", "list", "pipelines/spot/dvc.yaml")
    assert [line.split()[0] for line in stages.splitlines()] == [
        f"pipelines/spot/dvc.yaml:{stage}"
        for stage in ("recordings", "transitions", "train", "score", "report", "policy", "twin", "track", "diagnose")
    ]


def test_a_run_knows_dvcs_hash_of_what_it_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the real Spot, whose pipeline has a lock file of its own."""
    monkeypatch.chdir(ROOT)
    workspace = Workspace(Path(), "spot")
    known = provenance.tags(workspace, workspace.transitions)["dvc_transitions"]
    assert known in Path("pipelines", "spot", "dvc.lock").read_text()


def test_the_metrics_of_the_repository_fit_on_a_screen() -> None:
    shown = subprocess.run(
        [Path(sys.executable).parent / "dvc", "metrics", "show"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    head, *rows = shown.splitlines()
    assert {"nll_sim_fsvgd", "false_alarms", "right_name"} <= set(head.split())
    assert {row.split()[0] for row in rows} >= {"reports/virtual/metrics.json", "reports/spot/metrics.json"}
    assert max(map(len, shown.splitlines())) <= 120


def test_the_proofs_pipeline_is_complete(run: Callable[..., str]) -> None:
    stages = run("dvc", "stage", "list", "pipelines/sealed/dvc.yaml")
    assert [line.split()[0] for line in stages.splitlines()] == [
        f"pipelines/sealed/dvc.yaml:{stage}" for stage in ("conceal", "examine", "score")
    ]


@pytest.mark.parametrize(
    ("listed", "stages"),
    [
        (("list", "pipelines/external/dvc.yaml"), ["external"]),
        (("list", "pipelines/ground/dvc.yaml"), ["ground"]),
        (("list", "pipelines/diagnosed/dvc.yaml"), ["sweep"]),
        (("list", "pipelines/seeds/dvc.yaml"), ["sweep@spot", "sweep@virtual"]),
        (("list", "pipelines/long_tests/dvc.yaml"), ["simgap", "pipeline"]),
    ],
    ids=["external", "ground", "diagnosed", "seeds", "long_tests"],
)
def test_pipelines_beside_them_are_complete(
    run: Callable[..., str], listed: tuple[str, str], stages: list[str]
) -> None:
    found = run("dvc", "stage", *listed)
    assert [line.split()[0] for line in found.splitlines()] == [f"{listed[1]}:{stage}" for stage in stages]
