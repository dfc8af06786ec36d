"""Stage `track`: every policy on the robot, along an ellipse and a helix."""

from flows.start import main

if __name__ == "__main__":
    main("flows.track", __doc__)  # before the imports, which take seconds

import time
from pathlib import Path

from flows import policy as policy_flow
from flows import provenance
from flows.flow import flow
from simgap.cli import progress
from simgap.formats.folders import remove_folder
from simgap.policies.follow import Run
from simgap.types import SimgapError
from tasks import policy, track, track_report
from tasks.files.models import load_policy
from tasks.params import FolderParams, Params
from tasks.tracking.runs import grid_run
from tasks.workspace import Workspace

SHOWN = ("shape", "policy", "sample_size", "mean_error", "mean_error_std", "stopped")


@flow(name="track", flow_run_name="track-{source}")
def run(source: str, params: Params, root: Path) -> list[track_report.Row]:
    """Run every policy that there is, and the controllers to compare with; a missing policy is named.

    Returns a row for every policy and shape.
    """
    workspace, cells = Workspace(root, source), policy.grid(params.policy)
    remove_folder(workspace.tracks, root)
    remove_folder(workspace.tracking, root)
    store = provenance.store(policy_flow.EXPERIMENT)
    found = [cell for cell in cells if workspace.policy_record(cell).exists()]
    for cell in (cell for cell in cells if cell not in found):
        progress.say(f"no policy of {cell.name}: left out")
    if not found:
        raise SimgapError(f"{workspace.policies}: there is no policy of this grid. Run the stage `policy`.")
    recorded = isinstance(params.source(source), FolderParams)
    machine = track.robot(workspace, recorded, params.track)
    tags = provenance.tags(workspace, workspace.policies)
    controllers = track.controllers(params.track)
    rows: list[track_report.Row] = []
    runs: dict[tuple[str, str, int, int], Run] = {}
    with (
        grid_run(store, f"tracking-{source}", params.track.model_dump(), tags) as parent,
        progress.bars(f"track on {source}", len(found) + len(controllers), time.monotonic) as bars,
    ):
        for name, controller in controllers.items():
            with bars.job(name, 1):
                rows += track.run(workspace, name, controller, {"policy": name}, machine, params.track)[0]
        for cell in found:
            with bars.job(cell.name, 1):
                learnt, about = load_policy(workspace.policy(cell)), track.about(workspace, cell)
                new, done = track.run(workspace, cell.name, learnt, about, machine, params.track)
                track.log_cell(workspace, cell, new, store)
                rows += new
                runs |= {(shape, cell.model, cell.sample_size, cell.seed): r for shape, r in done.items()}
        notes = [track_report.on(workspace, recorded), *track_report.notes(workspace, found, params.policy)]
        summary = track_report.write(workspace, rows, runs, notes, params.report.figure_dpi)
        track.log(parent, workspace, summary)
    progress.table(f"tracking on {source}", [{k: row.get(k, "") for k in SHOWN} for row in summary])
    progress.say(f"report of tracking on {source}: {workspace.tracking / 'report.md'}")
    return rows
