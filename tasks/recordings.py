"""Stage `recordings`: sessions in, from the virtual Spot or from a folder, into the documented format."""

import jax
from prefect import task

from simgap.formats.recordings import read_recordings, write_recording
from simgap.robots.operator import OperatorConfig, record
from simgap.robots.virtual_spot import VirtualSpotConfig
from simgap.simulators.spot import SCHEMA
from simgap.types import Recording, RecordingError
from tasks.params import FolderParams, VirtualParams
from tasks.workspace import SPLITS, Workspace

FURTHER = "further"
"""Folder of the sessions that neither train nor test: those of one axis at a time, for a twin."""


@task(task_run_name="record-virtual-{workspace.source}")
def record_virtual(workspace: Workspace, params: VirtualParams) -> dict[str, int]:
    """Teleoperated sessions of the virtual Spot, written per split; returns rows per session."""
    counts = (params.training_sessions, params.test_sessions)
    keys = iter(jax.random.split(jax.random.key(params.seed), sum(counts)))
    sessions = {
        split: [
            record(next(keys), params.session_s, VirtualSpotConfig(), OperatorConfig(), f"{split}_{i:02d}")
            for i in range(count)
        ]
        for split, count in zip(SPLITS, counts, strict=True)
    }
    return _write(workspace, sessions)


@task(task_run_name="import-{workspace.source}")
def import_folder(workspace: Workspace, params: FolderParams, time_step: float) -> tuple[dict[str, int], list[str]]:
    """Sessions of a folder, written per split; returns rows per session, and what was wrong with sessions left out.

    Raises RecordingError when a split has no usable session, or when a session is in both.
    """
    sessions: dict[str, list[Recording]] = {}
    errors: list[RecordingError] = []
    for split, patterns in zip(SPLITS, (params.training, params.test), strict=True):
        sessions[split], bad = read_recordings(params.folder, SCHEMA, time_step, patterns)
        errors += bad
    if params.further:
        try:
            sessions[FURTHER], bad = read_recordings(params.folder, SCHEMA, time_step, params.further)
            errors += bad
        except RecordingError as error:  # nothing but a twin needs them, and it can do without
            errors.append(error)
    both = {r.name for r in sessions["training"]} & {r.name for r in sessions["test"]}
    if both:
        raise RecordingError(
            f"{params.folder}: session {', '.join(sorted(both))} matches both the training and the test patterns; "
            "sessions, never rows, separate training from test. Narrow the patterns in params.yaml."
        )
    return _write(workspace, sessions), [str(error) for error in errors]


def _write(workspace: Workspace, sessions: dict[str, list[Recording]]) -> dict[str, int]:
    rows = {}
    for split, recordings in sessions.items():
        for recording in recordings:
            write_recording(workspace.recordings / split, recording, SCHEMA)
            rows[f"{split}/{recording.name}"] = len(recording.time_s)
    return rows
