"""Stage `train`: SIM-MODEL, FSVGD and Sim-FSVGD over N and seeds."""

import time
from pathlib import Path

from prefect import flow
from prefect.task_runners import ThreadPoolTaskRunner

from flows.start import main
from simgap.types import SimgapError
from tasks import progress, train
from tasks.params import Params
from tasks.workspace import Workspace


@flow(name="train", flow_run_name="train-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Train every cell of the grid that is not finished; a failed cell is reported at the end and loses no other."""
    workspace, cells = Workspace(root, source), train.grid(params.train)
    train.remove_stale(workspace, cells)
    runner = ThreadPoolTaskRunner(max_workers=params.train.workers)
    with progress.bars(f"train on {source}", len(cells), time.monotonic) as bars, runner:
        futures = {
            cell: runner.submit(
                train.train_cell,
                {"workspace": workspace, "cell": cell, "params": params, "job": bars.job, "clock": time.perf_counter},
            )
            for cell in cells
        }
        states = {cell: (future.wait(), future.state)[1] for cell, future in futures.items()}
    failed = {cell: state for cell, state in states.items() if not state.is_completed()}
    for cell, state in failed.items():
        progress.say(f"failed: {cell.noise}/{cell.name}: {state.message}")
    if failed:
        raise SimgapError(
            f"{len(failed)} of {len(cells)} cells failed (see above); the others are kept. "
            "Mend the cause and start again: finished cells are not repeated."
        )


if __name__ == "__main__":
    main(run)
