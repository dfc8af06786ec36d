"""All stages in order, outside DVC: in a small size (`make run`), with other parameters, in a workspace of its own."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from prefect import flow

from flows import diagnose, policy, recordings, report, running, score, track, train, transitions
from flows.start import PARAMS, add_overrides, alone, guarded, read_overrides
from simgap.types import SimgapError
from tasks import progress
from tasks.diagnose import PAGE
from tasks.params import Params, load_params
from tasks.workspace import Workspace


@flow(name="reproduce", flow_run_name="reproduce-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Recordings to report and diagnosis in the folder `root`; cells that failed are told once the rest is done."""
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


def _main() -> None:
    parser = argparse.ArgumentParser(description=run.__doc__)
    parser.add_argument("source", nargs="?", default="virtual", help="a block of params.yaml's recordings")
    parser.add_argument("--workspace", type=Path, required=True, help="folder for data, models and report")
    add_overrides(parser)
    parser.add_argument("--recordings", type=Path, help="folder that takes the place of the source's own")
    arguments = parser.parse_args()

    def work() -> None:
        overrides = read_overrides(arguments)
        if arguments.recordings:
            overrides.append({"recordings": {arguments.source: {"folder": str(arguments.recordings)}}})
        params = load_params(PARAMS, *overrides)
        with alone(arguments.workspace, arguments.source):
            run(arguments.source, params, arguments.workspace)

    guarded(work)


if __name__ == "__main__":
    _main()
