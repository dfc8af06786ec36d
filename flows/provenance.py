"""Where a run comes from: what the environment, git and DVC know of it."""

import os
import subprocess
from pathlib import Path

import yaml
from prefect.runtime import flow_run

from tasks import tracking
from tasks.workspace import Workspace

EXPERIMENT = "model-validation"


def store() -> tracking.Store:
    """The project's MLflow store, or the one that MLFLOW_TRACKING_URI names; runs left open by a kill are closed."""
    opened = tracking.open_store(Path(), EXPERIMENT, os.environ.get("MLFLOW_TRACKING_URI"))
    tracking.close_stale_runs(opened)
    return opened


def tags(workspace: Workspace) -> dict[str, str]:
    """Git commit, DVC's hash of the transitions, Prefect's flow run, source and workspace."""
    found = {
        "source": workspace.source,
        "workspace": str(workspace.root),
        "git_commit": _git_commit(),
        "dvc_transitions": _dvc_hash(workspace),
        "prefect_flow_run": str(flow_run.get_id() or ""),
    }
    return {name: value for name, value in found.items() if value}


def _git_commit() -> str:
    try:
        commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run(["git", "status", "--porcelain"], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return ""
    return f"{commit}-changed" if changed.strip() else commit


def _dvc_hash(workspace: Workspace) -> str:
    """DVC's hash of the transitions, where the last `dvc repro` recorded one."""
    for lock in (Path("dvc.lock"), Path(workspace.source, "dvc.lock")):
        stages = (yaml.safe_load(lock.read_text()) or {}).get("stages", {}) if lock.exists() else {}
        for out in stages.get("transitions", {}).get("outs", []):
            if Path(out["path"]) == workspace.transitions:
                return out["md5"]
    return ""
