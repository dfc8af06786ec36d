"""Commands keep to their workspace and to themselves: nothing outside is touched, and two do not share one."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml
from test_pipeline import ROOT, TINY, finish, launch, prepare

from tasks.params import load_params
from tasks.workspace import Cell, Workspace

ONE: dict[str, Any] = {"models": ["sim_model"], "sample_sizes": [40]}
BLOCK = {"training_sessions": 2, "test_sessions": 1, "session_s": 3.0, "seed": 0}
CONFLICT = "stages:\n<<<<<<< HEAD\n  train: {}\n=======\n>>>>>>> other\n"


def place(folder: Path, more: Mapping[str, Any] = {}) -> Path:
    """A project's folder with tiny parameters; `more` is merged in, unchecked."""
    folder.mkdir()
    params = load_params(ROOT / "params.yaml", {**TINY, "train": {**TINY["train"], **ONE}}).model_dump(mode="json")
    (folder / "params.yaml").write_text(yaml.safe_dump({**params, **more}))
    return folder


def ran(folder: Path, command: Sequence[str], environment: Mapping[str, str]) -> tuple[int, str]:
    """Exit status of a command beside another one, and what it prints."""
    done = subprocess.run([sys.executable, "-m", *command], cwd=folder, env={**environment, "PYTHONPATH": str(ROOT)},
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=600)  # fmt: skip
    return done.returncode, done.stdout


@pytest.mark.parametrize("stage", ["recordings", "reproduce"])
def test_a_source_that_would_leave_the_project_is_refused(tmp_path: Path, stage: str) -> None:
    """It would write there, and at the second time delete what is there."""
    project = place(tmp_path / "project", {"recordings": {"../../theirs": BLOCK}})
    theirs = tmp_path / "theirs" / "recordings" / "thesis.tex"
    theirs.parent.mkdir(parents=True)
    theirs.write_text("years of work")
    where = ("--workspace", ".") if stage == "reproduce" else ()
    status, output = finish(launch(project, (f"flows.{stage}", "../../theirs", *where), os.environ), project)
    assert theirs.read_text() == "years of work"
    assert [path.name for path in theirs.parent.iterdir()] == ["thesis.tex"]
    assert status == 1
    assert "recordings.../../theirs" in output
    assert "must begin with a letter or digit" in output
    assert "Traceback" not in output


def test_recordings_that_are_a_link_out_of_the_project_are_not_deleted(tmp_path: Path) -> None:
    project, theirs = place(tmp_path / "project"), tmp_path / "theirs"
    theirs.mkdir()
    (theirs / "thesis.tex").write_text("years of work")
    recordings = Workspace(project, "virtual").recordings
    recordings.parent.mkdir(parents=True)
    recordings.symlink_to(theirs)
    status, output = finish(launch(project, ("flows.recordings", "virtual"), os.environ), project)
    assert [path.name for path in theirs.iterdir()] == ["thesis.tex"]
    assert status == 1
    assert f"error: data/virtual/recordings: leads to {theirs}, which does not lie in {project}" in output
    assert "Traceback" not in output


@pytest.mark.long
def test_a_second_command_in_one_workspace_is_refused_and_deletes_nothing(tmp_path: Path) -> None:
    """Whereas a sweep, which has a workspace of its own, goes on beside the first."""
    project = place(tmp_path / "project")
    workspace = Workspace(project, "virtual")
    prepare(workspace, load_params(project / "params.yaml"))
    endless = {"max_training_steps": 10_000_000, "epochs": 10_000, "patience": 10_000_000, "evaluate_every": 50}
    (project / "long.yaml").write_text(
        yaml.safe_dump({"train": {"models": ["sim_model", "fsvgd"], "workers": 1, "bnn": endless}})
    )
    (project / "other.yaml").write_text(yaml.safe_dump({"train": {"seeds": [1]}}))
    first = launch(project, ("flows.train", "virtual", "--overrides", "long.yaml"), os.environ)
    try:
        record, deadline = workspace.record(Cell("student_t", "sim_model", 40, 0)), time.monotonic() + 300
        while not record.exists():
            assert first.poll() is None, (project / "output.txt").read_text()
            assert time.monotonic() < deadline
            time.sleep(0.1)
        before = record.read_bytes()
        os.setpriority(os.PRIO_PGRP, first.pid, 19)  # it is to be at work, and not in the way of the others
        other = ("flows.train", "virtual", "--overrides", "other.yaml")
        status, output = ran(project, other, os.environ)
        assert status == 1
        assert f"data/.virtual.lock: held by process {first.pid} on " in output
        assert "-m flows.train virtual --overrides long.yaml. Two commands" in output
        assert "Traceback" not in output
        assert record.read_bytes() == before
        sweep = ("flows.sweep", "virtual", "--name", "other", "--models", "sim_model")
        status, output = ran(project, sweep, os.environ)
        assert status == 0, output
        assert first.poll() is None
    finally:
        os.killpg(first.pid, signal.SIGKILL)
        first.wait()
    status, output = ran(project, other, os.environ)
    assert status == 0, output
    assert [p.stem for p in workspace.models.glob("*.json")] == ["sim_model-student_t-N40-s1"]


@pytest.mark.parametrize(
    ("lock", "content", "words"),
    [
        ("dvc.lock", CONFLICT, "line 2 is the mark <<<<<<< of a merge"),
        ("pipelines/virtual/dvc.lock", "[1, 2]", "is no lock file of DVC"),
    ],
)
def test_a_damaged_lock_file_of_dvc_is_one_clear_line(tmp_path: Path, lock: str, content: str, words: str) -> None:
    project = place(tmp_path / "project")
    (project / lock).parent.mkdir(parents=True, exist_ok=True)
    (project / lock).write_text(content)
    status, output = finish(launch(project, ("flows.train", "virtual"), os.environ), project)
    assert status == 1
    (line,) = (line for line in output.splitlines() if line.startswith("error: "))
    assert line.startswith(f"error: {lock}: {words}")
    assert "Traceback" not in output, output
