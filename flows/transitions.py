"""Stage `transitions`: sessions to rows for learning."""

from flows.start import main

if __name__ == "__main__":
    main("flows.transitions", __doc__)  # before the imports, which take seconds

from pathlib import Path

from flows.flow import flow
from simgap.cli import progress
from tasks import transitions
from tasks.params import Params
from tasks.workspace import SPLITS, Workspace


@flow(name="transitions", flow_run_name="transitions-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Write the transitions of the training and of the test sessions."""
    workspace, time_step = Workspace(root, source), 1 / params.transitions.nominal_rate_hz
    counts = {split: transitions.prepare(workspace, split, time_step) for split in SPLITS}
    progress.say(f"transitions of {source}: " + ", ".join(f"{n:,} {split}" for split, n in counts.items()))
