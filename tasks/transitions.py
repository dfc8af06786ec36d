"""Stage `transitions`: sessions to rows for learning, x in R^31 and y in R^13."""

import hashlib
from pathlib import Path

import numpy as np
from prefect import task

from simgap.formats.arrays import load_arrays, save_arrays
from simgap.formats.recordings import read_recordings
from simgap.recordings import to_transitions
from simgap.simulators.spot import SCHEMA
from simgap.types import Transitions
from tasks.workspace import SPLITS, Workspace


@task(task_run_name="transitions-{workspace.source}-{split}")
def prepare(workspace: Workspace, split: str, time_step: float) -> int:
    """All transitions of a split's sessions, written as arrays; returns how many."""
    recordings, errors = read_recordings(workspace.recordings / split, SCHEMA, time_step)
    if errors:
        raise errors[0]
    transitions = to_transitions(SCHEMA, recordings)
    save_arrays(_path(workspace, split), {k: np.asarray(v) for k, v in transitions._asdict().items()})
    return len(transitions.x)


def load(workspace: Workspace, split: str) -> Transitions:
    """The transitions that `prepare` wrote."""
    return Transitions(**load_arrays(_path(workspace, split)))  # type: ignore[arg-type]


def digest(workspace: Workspace) -> str:
    """Identifies the transitions of all splits by their content."""
    mark = hashlib.sha256()
    for split in SPLITS:
        for name, array in sorted(load_arrays(_path(workspace, split)).items()):
            mark.update(f"{split} {name} {array.dtype} {array.shape}".encode())
            mark.update(np.ascontiguousarray(array).tobytes())
    return mark.hexdigest()[:16]


def _path(workspace: Workspace, split: str) -> Path:
    return workspace.transitions / f"{split}.npz"
