"""Stage `report`: tables, figures and the paper's claims."""

from flows.start import main

if __name__ == "__main__":
    main("flows.report", __doc__)  # before the imports, which take seconds

from pathlib import Path

from flows.flow import flow
from simgap.cli import progress
from tasks import report, score
from tasks.params import Params
from tasks.workspace import Workspace

SHOWN = ("noise", "model", "sample_size", "nll", "nll_std", "nll_median", "calibration_error")


@flow(name="report", flow_run_name="report-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Write the report of a source's grid and print its summary."""
    workspace = Workspace(root, source)
    summary = report.write(workspace, score.load(workspace), params.train.noises, params.report.figure_dpi)
    progress.table(f"scores on {source}", [{k: row[k] for k in SHOWN if k in row} for row in summary])
    progress.say(f"report of {source}: {workspace.reports / 'report.md'}")
