"""Where a run comes from: what the environment, git and DVC know of it."""

import os
import subprocess
from pathlib import Path

from prefect.runtime import flow_run

from flows import running
from simgap.formats.yaml_files import read_yaml
from simgap.types import ConfigError
from tasks.tracking.runs import close_stale_runs
from tasks.tracking.store import Store, open_store
from tasks.workspace import Workspace

EXPERIMENT = "model-validation"


def store(experiment: str = EXPERIMENT) -> Store:
    """The project's MLflow store, or the one that MLFLOW_TRACKING_URI names; runs left open by a kill are closed."""
    server = running.find("mlflow")
    pages = server.address if server else ""
    opened = open_store(Path(), experiment, os.environ.get("MLFLOW_TRACKING_URI"), pages)
    close_stale_runs(opened)
    return opened


def origin() -> dict[str, str]:
    """Git commit and Prefect's flow run."""
    found = {"git_commit": _git_commit(), "prefect_flow_run": str(flow_run.get_id() or "")}
    return {name: value for name, value in found.items() if value}


def tags(workspace: Workspace, used: Path) -> dict[str, str]:
    """The run's origin, source and workspace, and DVC's hash of what is used: the output of the stage of its name."""
    found = {
        "source": workspace.source,
        "workspace": str(workspace.root),
        f"dvc_{used.name}": _dvc_hash(workspace.source, used),
        **origin(),
    }
    return {name: value for name, value in found.items() if value}


def _git_commit() -> str:
    try:
        commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run(["git", "status", "--porcelain"], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return ""
    return f"{commit}-changed" if changed.strip() else commit


def _dvc_hash(source: str, used: Path) -> str:
    """DVC's hash of a stage's output, where the last `dvc repro` recorded one; ConfigError for a damaged dvc.lock."""
    for lock in (path for path in (Path("dvc.lock"), Path("pipelines", source, "dvc.lock")) if path.exists()):
        known = read_yaml(lock)
        try:
            for out in known["stages"].get(used.name, {}).get("outs", []):
                if Path(out["path"]) == used:
                    return out["md5"]
        except (AttributeError, KeyError, TypeError):
            raise ConfigError(
                f"{lock}: is no lock file of DVC. Restore it, with `git checkout -- {lock}`, or delete it and run "
                "`dvc repro`."
            ) from None
    return ""
