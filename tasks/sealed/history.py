"""The scores of every version of the diagnosis as one table, which outlives the reports."""

import csv
import fcntl
from collections.abc import Mapping, Sequence
from typing import Any

from simgap.formats.documents import read_bytes, write_table
from simgap.formats.folders import make_folder
from tasks.sealed.metrics import Score
from tasks.sealed.workspace import SealedWorkspace

KEY = ("suite", "code", "round")
"""What a version of the scores is known by."""


def add(workspace: SealedWorkspace, about: Mapping[str, Any], table: Sequence[Score]) -> None:
    """Write scores to the table of all suites, in place of earlier ones of the same key.

    about: suite, code, round, and what else is known, the same for every score.
    """
    scores = [{**about, "score": s.name, "value": s.value, "low": s.low, "high": s.high, "n": s.n} for s in table]
    make_folder(workspace.history_lock.parent)
    with open(workspace.history_lock, "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # suites are scored side by side
        key = [str(about[name]) for name in KEY]
        kept = [row for row in _rows(workspace) if [row[name] for name in KEY] != key]
        write_table(workspace.history, [*kept, *scores])


def _rows(workspace: SealedWorkspace) -> list[dict[str, str]]:
    if not workspace.history.exists():
        return []
    return list(csv.DictReader(read_bytes(workspace.history).decode().splitlines()))
