"""Stage `score`: every model of the grid on the test sessions."""

from flows.start import main

if __name__ == "__main__":
    main("flows.score", __doc__)  # before the imports, which take seconds

import time
from pathlib import Path

from flows import provenance
from flows.flow import flow
from simgap.cli import progress
from tasks import score, train
from tasks.params import Params
from tasks.workspace import Workspace


@flow(name="score", flow_run_name="score-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Score every cell that has a model; a missing one is named."""
    workspace, cells = Workspace(root, source), train.grid(params.train)
    store = provenance.store()
    test = score.load_test(workspace, 1 / params.transitions.nominal_rate_hz)
    rows = []
    with progress.bars(f"score on {source}", len(cells), time.monotonic) as bars:
        for cell in cells:
            with bars.job(cell.name, 1):
                if workspace.record(cell).exists():
                    rows.append(score.score_cell(workspace, cell, test, params.score))
                    score.log_scores(workspace, cell, rows[-1], store)
                else:
                    progress.say(f"no model of {cell.name}: left out of the scores")
    score.write(workspace, rows)
