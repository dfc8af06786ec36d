"""How far models run from what was measured on held-out sessions, where nothing corrects them for seconds."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.diagnosis.likelihood.problem import Problem
from simgap.diagnosis.likelihood.segments import RUN_IN, Chunks
from simgap.diagnosis.validation.forecast import Contestant, forecast, windows
from simgap.kinematics import wrapped
from simgap.rows import by_row
from simgap.types import Recording

LONGEST_S = 5.0
"""Length of the pieces of sessions that are replayed [s], or of the longest session where that is shorter."""


def pieces_of(heldout: Sequence[Recording], time_step: float) -> Chunks | None:
    """Pieces to replay, one behind the other; None where sessions are too short for any."""
    longest = max(len(r.time_s) for r in heldout) - RUN_IN - 1
    rows = min(round(LONGEST_S / time_step), longest)
    return windows(heldout, time_step, rows, rows) if rows > 0 else None


def replay(problem: Problem, contestants: Mapping[str, Contestant], pieces: Chunks) -> dict[str, Any]:
    """Root mean square error over the pieces of every position that is measured, by model, in its unit."""
    simulator, rows = problem.augmented.simulator, pieces.state.shape[1] - RUN_IN - 1
    fields = [(i, f) for i, f in enumerate(simulator.schema.outputs) if f.kind in ("position", "angle")]
    measured = np.asarray(pieces.state)[:, RUN_IN + 1 :]
    missed = {
        name: by_row(wrapped, problem.augmented.layout, measured - forecast(problem, model, pieces))
        for name, model in contestants.items()
    }
    errors = {name: np.sqrt(np.mean(np.square(e, dtype=float), axis=(0, 1))) for name, e in missed.items()}
    return {
        "seconds": rows * simulator.time_step, "pieces": len(pieces.row),
        "positions": [
            {"name": f.name, "unit": f.unit, "errors": {name: float(e[i]) for name, e in errors.items()}}
            for i, f in fields
        ],
    }  # fmt: skip
