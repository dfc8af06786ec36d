"""What the cells of every grid share: whether one is finished, the curve of its training, when to try again."""

from pathlib import Path
from typing import Any

from simgap.types import Report, SimgapError
from tasks.files.digests import fingerprint_of
from tasks.tracking.store import StoreError


def may_pass(_task: Any, _run: Any, state: Any) -> bool:
    """Whether a failure may pass by itself: what the project explains as wrong input or divergence does not."""
    error = state.result(raise_on_failure=False)
    return not isinstance(error, SimgapError) or isinstance(error, StoreError)


def finished(result: Path, record: Path, fingerprint: str) -> bool:
    """Whether the cell was made before of the same data, parameters and code; a damaged file is as none."""
    return fingerprint_of(record, result) == fingerprint


class Curve:
    """A report that keeps the metrics by step, after those of `curve`, and passes them on."""

    def __init__(self, report: Report, curve: dict[str, list[float]]) -> None:
        self.curve = curve
        self._report = report

    def __call__(self, step: int, metrics: dict[str, float]) -> None:
        for name, value in {"step": step, **metrics}.items():
            self.curve.setdefault(name, []).append(value)
        self._report(step, metrics)
