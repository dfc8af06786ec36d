"""Stage `twin`: a robot that stands in for the recorded one, for policies to run on."""

from flows.start import main

if __name__ == "__main__":
    main("flows.twin", __doc__)  # before the imports, which take seconds

import time
from pathlib import Path

from flows import provenance
from flows.flow import flow
from simgap.cli import progress
from tasks import fingerprint, twin, twin_report
from tasks.params import Params, VirtualParams
from tasks.tracking.runs import grid_run
from tasks.workspace import Workspace

EXPERIMENT = "twins"


@flow(name="twin", flow_run_name="twin-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Fit a twin to all sessions of a source, and one without each fold to score; a virtual robot needs none."""
    if isinstance(params.source(source), VirtualParams):
        progress.say(f"{source} is a virtual robot: policies run on itself, and it needs no twin")
        return
    workspace = Workspace(root, source)
    store, tags = provenance.store(EXPERIMENT), provenance.tags(workspace, workspace.recordings)
    code, diagnosis = map(fingerprint.code_digest, (fingerprint.TWIN, fingerprint.DIAGNOSIS))
    context = twin.Context(params, code, diagnosis, time.perf_counter, lambda line: progress.say(f"  {line}"))
    recorded, shares = twin.load(workspace, context.time_step), twin.shares(context.folds)
    steps = params.train.residual.simulator_steps + params.twin.fit.training_steps
    with (
        grid_run(store, f"twin-{source}", params.twin.model_dump(), tags) as run,
        progress.bars(f"twin of {source}", len(shares), time.monotonic) as bars,
    ):
        rows = []
        for share in shares:
            with bars.job(share.name, steps) as report:
                twin.diagnose(workspace, share, recorded, context)
                if share.held_out is None:
                    twin.fit_all(workspace, recorded, context, report)
                else:
                    rows += twin.fold_scores(workspace, share, recorded, context, report)
        summary = twin_report.write(workspace, rows, params.report.figure_dpi)
        twin_report.log(run, workspace, summary)
    progress.say(f"report of the twin of {source}: {workspace.twin_report / 'report.md'}")
