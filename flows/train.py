"""Stage `train`: SIM-MODEL, FSVGD and Sim-FSVGD over N and seeds; the simulator also with what a diagnosis adds."""

from flows.start import main

if __name__ == "__main__":
    main("flows.train", __doc__)  # before the imports, which take seconds

import time
from collections.abc import Mapping
from pathlib import Path

from flows import provenance
from flows.fan_out import Place, fan_out
from flows.flow import flow
from simgap.cli import progress
from simgap.formats.folders import remove_file
from simgap.types import SimgapError
from tasks import diagnosed, fingerprint, train
from tasks.params import Params
from tasks.tracking import links
from tasks.tracking.runs import Run, grid_run
from tasks.workspace import Workspace


@flow(name="train", flow_run_name="train-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Train every cell of the grid that is not finished; a failed cell is reported at the end and loses no other."""
    workspace, cells = Workspace(root, source), train.grid(params.train)
    train.remove_stale(workspace, cells)
    tags, store = provenance.tags(workspace, workspace.transitions), provenance.store()
    with grid_run(store, f"grid-{source}", params.train.model_dump(), tags) as parent:
        progress.say(f"MLflow: {links.to_run(store, parent.run_id)}")
        failed = train_cells({(workspace, cell): params for cell in cells}, tags, parent)
        if failed:
            raise SimgapError(failures(failed, len(cells)))


def train_cells(cells: Mapping[Place, Params], tags: dict[str, str], parent: Run) -> dict[Place, str]:
    """Train cells that share their recordings, each with its parameters; returns what went wrong, by cell."""
    (workspace, _), params = next(iter(cells.items()))
    grid = train.Grid(parent, tags, fingerprint.codes())
    failed = _diagnose(list(cells), params, grid.codes)
    able = {place: {"params": p, "grid": grid} for place, p in cells.items() if place not in failed}
    return failed | fan_out(f"train on {workspace.source}", train.train_cell, able, params.train.workers)


def failures(failed: Mapping[Place, str], count: int) -> str:
    """What failed and what to do, as an error's message."""
    lines = [f"  {cell.name}{workspace.suffix}: {why}" for (workspace, cell), why in failed.items()]
    return (
        f"{len(failed)} of {count} cells failed; the others are kept:\n" + "\n".join(lines)
        + "\nMend the cause and start again: finished cells are not repeated."
    )  # fmt: skip


def _diagnose(places: list[Place], params: Params, codes: fingerprint.Codes) -> dict[Place, str]:
    """What cells need to know of their recordings, one diagnosis at a time: each takes all cores for itself.

    Returns what went wrong, by cell; such cells have no record left.
    """
    failed: dict[Place, str] = {}
    wanted = list(dict.fromkeys((w, share) for w, cell in places for share in diagnosed.shares([cell])))
    for i, (workspace, share) in enumerate(wanted):
        progress.say(f"{share.name} ({i + 1} of {len(wanted)})")
        common = (1 / params.transitions.nominal_rate_hz, codes.diagnosis, lambda line: progress.say(f"  {line}"))
        state = diagnosed.find(workspace, share, *common, time.perf_counter, return_state=True)
        if not state.is_completed():
            for place in (p for p in places if (p[0], p[1].share) == (workspace, share)):
                remove_file(workspace.record(place[1]), workspace.root)
                failed[place] = str(state.message)
    return failed
