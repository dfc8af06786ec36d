"""All stages in order, outside DVC: in a small size (`make run`), with other parameters, in a workspace of its own."""

from flows.start import main_apart

if __name__ == "__main__":
    main_apart("flows.reproduce", __doc__)  # before the imports, which take seconds

from collections.abc import Callable
from pathlib import Path
from typing import Any

from flows import diagnose, policy, recordings, report, running, score, track, train, transitions, twin
from flows.flow import flow
from simgap.cli import progress
from simgap.types import SimgapError
from tasks.diagnose import PAGE
from tasks.params import Params
from tasks.workspace import Workspace


@flow(name="reproduce", flow_run_name="reproduce-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Recordings to report and diagnosis in the folder `root`; cells that failed are reported once the rest is done."""
    recordings.run(source, params, root)
    transitions.run(source, params, root)
    failures: list[SimgapError] = []

    def attempt(stage: Callable[..., Any]) -> None:
        try:
            stage(source, params, root)
        except SimgapError as error:
            failures.append(error)
            progress.say(f"error: {error}\nThe rest follows for what there is.")

    attempt(train.run)
    score.run(source, params, root)
    report.run(source, params, root)
    attempt(policy.run)
    attempt(twin.run)
    attempt(track.run)
    diagnose.run(source, params, root)
    workspace, server = Workspace(root, source), running.find("mlflow")
    pages = server.address if server else ".venv/bin/mlflow ui --backend-store-uri sqlite:///mlflow.db"
    progress.say(
        f"\nreport     {workspace.reports / 'report.md'}\nfigures    {workspace.reports}\n"
        f"tracking   {workspace.tracking / 'report.md'}\ndiagnosis  {workspace.diagnosis / PAGE}\n"
        f"MLflow     {pages}   (experiments model-validation, policies and diagnosis)"
    )
    if failures:
        raise failures[0]
