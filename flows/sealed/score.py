"""Stage `score`: what was said against what is true, with report, figures and an MLflow run of the suite."""

from flows.sealed.start import main

if __name__ == "__main__":
    main("flows.sealed.score", __doc__)  # before the imports, which take seconds

import time
from pathlib import Path

from flows import provenance
from flows.flow import flow
from simgap.cli import progress
from tasks.params_sealed import SealedParams
from tasks.sealed import score
from tasks.sealed.workspace import SealedWorkspace
from tasks.tracking import links
from tasks.tracking.runs import grid_run

EXPERIMENT = "sealed"


@flow(name="score-sealed", flow_run_name="score-{suite}")
def run(suite: str, params: SealedParams, root: Path) -> None:
    """Open the keys and score all cases that were examined."""
    workspace, origin = SealedWorkspace(root, suite), provenance.origin()
    opened = score.open_keys(workspace)
    with progress.bars(f"score {suite}", 1, time.monotonic) as bars, bars.job(suite, len(opened.keys)) as report:
        found = score.rows(workspace, opened, report)
    table = score.write(workspace, opened, found, params.score, origin.get("git_commit", ""))
    store = provenance.store(EXPERIMENT)
    with grid_run(store, f"{suite}-{opened.code[:8]}", params.model_dump(), origin) as parent:
        score.log(parent, workspace, opened, table)
    progress.table(f"scores on {suite}", [{"score": s.name, "value": s.value, "n": s.n, "goal": s.goal} for s in table])
    progress.say(f"report of {suite}: {workspace.report(opened.code, opened.manifest['round']) / 'report.md'}")
    progress.say(f"MLflow: {links.to_run(store, parent.run_id)}")
