"""Stage `recordings`: sessions in, from the virtual Spot or from a folder."""

from flows.start import main

if __name__ == "__main__":
    main("flows.recordings", __doc__)  # before the imports, which take seconds

from pathlib import Path

from flows.flow import flow
from simgap.cli import progress
from simgap.formats.folders import remove_folder
from tasks import recordings
from tasks.params import Params, VirtualParams
from tasks.workspace import Workspace


@flow(name="recordings", flow_run_name="recordings-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Write the training and test sessions of a source in the documented format."""
    workspace, block = Workspace(root, source), params.source(source)
    remove_folder(workspace.recordings, root)
    if isinstance(block, VirtualParams):
        rows = recordings.record_virtual(workspace, block)
    else:
        rows, errors = recordings.import_folder(workspace, block, 1 / params.transitions.nominal_rate_hz)
        for error in errors:
            progress.say(f"left out: {error}")
    progress.say(f"recordings of {source}: {len(rows)} sessions, {sum(rows.values()):,} rows in {workspace.recordings}")
