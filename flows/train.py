"""Stage `train`: SIM-MODEL, FSVGD and Sim-FSVGD over N and seeds; the simulator also with what a diagnosis adds."""

import time
from pathlib import Path

from prefect import flow
from prefect.task_runners import ThreadPoolTaskRunner

from flows import provenance
from flows.start import main
from simgap.types import SimgapError
from tasks import diagnosed, fingerprint, progress, tracking, train
from tasks.params import Params
from tasks.workspace import Cell, Workspace


@flow(name="train", flow_run_name="train-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Train every cell of the grid that is not finished; a failed cell is reported at the end and loses no other."""
    workspace, cells = Workspace(root, source), train.grid(params.train)
    train.remove_stale(workspace, cells)
    tags, store = provenance.tags(workspace, workspace.transitions), provenance.store()
    with tracking.grid_run(store, f"grid-{source}", params.train.model_dump(), tags) as parent:
        progress.say(f"MLflow: {tracking.link(store, parent.run_id)}")
        codes = fingerprint.codes()
        failed = _diagnose(workspace, cells, params, codes)
        able = [cell for cell in cells if cell.name not in failed]
        failed |= _fan_out(workspace, able, params, train.Grid(parent, tags, codes))
        if failed:
            raise SimgapError(
                f"{len(failed)} of {len(cells)} cells failed; the others are kept:\n"
                + "\n".join(f"  {name}: {why}" for name, why in failed.items())
                + "\nMend the cause and start again: finished cells are not repeated."
            )


def _diagnose(workspace: Workspace, cells: list[Cell], params: Params, codes: fingerprint.Codes) -> dict[str, str]:
    """What cells need to know of their recordings, one diagnosis at a time: each takes all cores for itself.

    Returns what went wrong, by cell; such cells have no record left.
    """
    shares, failed = diagnosed.shares(cells), {}
    for i, share in enumerate(shares):
        progress.say(f"{share.name} ({i + 1} of {len(shares)})")
        common = (1 / params.transitions.nominal_rate_hz, codes.diagnosis, lambda line: progress.say(f"  {line}"))
        state = diagnosed.find(workspace, share, *common, time.perf_counter, return_state=True)
        if not state.is_completed():
            for cell in (c for c in cells if c.share == share):
                workspace.record(cell).unlink(missing_ok=True)
                failed[cell.name] = str(state.message)
    return failed


def _fan_out(workspace: Workspace, cells: list[Cell], params: Params, grid: train.Grid) -> dict[str, str]:
    """A task a cell, `params.train.workers` at a time; returns what went wrong, by cell."""
    runner = ThreadPoolTaskRunner(max_workers=params.train.workers)
    with progress.bars(f"train on {workspace.source}", len(cells), time.monotonic) as bars, runner:
        common = {"workspace": workspace, "params": params, "grid": grid, "job": bars.job, "clock": time.perf_counter}
        futures = {cell.name: runner.submit(train.train_cell, {"cell": cell, **common}) for cell in cells}
        for future in futures.values():
            future.wait()
    return {name: str(f.state.message) for name, f in futures.items() if not f.state.is_completed()}


if __name__ == "__main__":
    main(run)
