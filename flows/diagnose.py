"""Stage `diagnose`: what the simulator leaves out, from a source's recordings or from a folder of one's own."""

from flows.start import main

if __name__ == "__main__":
    main("flows.diagnose", __doc__)  # before the imports, which take seconds

import time
from pathlib import Path
from typing import NamedTuple

from flows import provenance
from flows.flow import flow
from simgap.cli import progress
from simgap.cli.diagnose import say_what_is_read, summary
from simgap.cli.locks import alone
from simgap.engines import Engine
from simgap.formats.folders import make_folder
from simgap.formats.purposes import Folders
from simgap.loading.load import load
from simgap.simulators.spot import Spot
from simgap.types import StepModel
from tasks import diagnose
from tasks.params import Params
from tasks.tracking import links
from tasks.tracking.runs import diagnosis_run
from tasks.workspace import Workspace

EXPERIMENT = "diagnosis"


@flow(name="diagnose", flow_run_name="diagnose-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Say what the kinematic model leaves out of a source's training sessions, judged on its test sessions."""
    workspace = Workspace(root, source)
    folders = Folders(workspace.recordings / "training", workspace.recordings / "test")
    spot = Spot(time_step=1 / params.transitions.nominal_rate_hz)
    tags = provenance.tags(workspace, workspace.recordings)
    asked = _Asked(source, "spot", spot, folders, params.diagnose.seed)
    _diagnose(asked, _read(asked), workspace.diagnosis, tags)


@flow(name="diagnose-folder", flow_run_name="diagnose-{recordings}")
def diagnose_folder(
    recordings: Path, simulator: str, baseline: Path | None, heldout: Path | None, out: Path, seed: int = 0
) -> str:
    """Say what a simulator, given as `simgap.loading.load` takes it, leaves out of a folder's sessions.

    Returns the run's id in MLflow.
    """
    folders = Folders(recordings, heldout, baseline)
    asked = _Asked(recordings.resolve().name, simulator, load(simulator), folders, seed)
    sessions = _read(asked)
    with alone(out):
        return _diagnose(asked, sessions, out, provenance.origin())


class _Asked(NamedTuple):
    """What is to be diagnosed: the recordings' label, the simulator and its name; the run is called by both."""

    label: str
    name: str
    simulator: StepModel | Engine
    folders: Folders
    seed: int


def _read(asked: _Asked) -> diagnose.Sessions:
    sessions, errors = diagnose.read(asked.folders, asked.simulator)
    say_what_is_read(asked.name, asked.label, sessions, errors)
    return sessions


def _diagnose(asked: _Asked, sessions: diagnose.Sessions, out: Path, tags: dict[str, str]) -> str:
    """Diagnose, write to `out`, log; returns the run's id in MLflow."""
    label, name, simulator, folders, seed = asked
    make_folder(out)  # before the work, not after it
    store = provenance.store(EXPERIMENT)
    with diagnosis_run(store, f"{label}-{name}", tags) as tracked:
        diagnose.log_recordings(tracked, name, folders, sessions, seed)
        start = time.perf_counter()
        found = diagnose.find(simulator, name, sessions, seed, lambda line: progress.say(f"  {line}"))
        seconds = time.perf_counter() - start
        diagnose.write(out, found, simulator.schema)
        diagnose.log(tracked, out, found, simulator.schema, seconds)
    progress.say(f"\n{summary(found.statement, out, seconds)}\n{'MLflow':10}{links.to_run(store, tracked.run_id)}")
    return tracked.run_id
