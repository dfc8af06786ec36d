"""Open-loop errors on held-out sessions: models run for seconds without corrections by measurements."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.likelihood.problem import Problem
from simgap.diagnosis.likelihood.segments import MOST, RUN_IN, Chunks, thinning
from simgap.diagnosis.validation.forecast import Contestant, forecast, windows
from simgap.engines import Engine
from simgap.kinematics import wrapped
from simgap.rows import by_row
from simgap.types import Recording

LONGEST_S = 5.0
"""Length of the replayed pieces [s]; that of the longest session if it is shorter."""


def pieces_of(heldout: Sequence[Recording], engine: Engine) -> Chunks | None:
    """Pieces to replay: consecutive ones, with gaps if there are many rows; None if all sessions are too short.

    A row of a replay takes one evaluation of the engine, so there may be as many as without an engine.
    """
    longest = max(len(r.time_s) for r in heldout) - RUN_IN - 1
    rows = min(round(LONGEST_S / engine.time_step), longest)
    return windows(heldout, engine.time_step, rows, thinning(heldout, MOST) * rows) if rows > 0 else None


class Run(NamedTuple):
    """A model, and the pieces that it replays. All models of a replay have the same rows and measured states; an engine
    may have unmeasured states of its own, which come last."""

    problem: Problem
    model: Contestant
    pieces: Chunks

    @property
    def residuals(self) -> Float[np.ndarray, "C T s"]:
        """Measured states minus the replayed ones."""
        measured = np.asarray(self.pieces.state)[:, RUN_IN + 1 :]
        return by_row(wrapped, self.problem.augmented.layout, measured - forecast(*self))


def replay(models: Mapping[str, Run]) -> dict[str, Any]:
    """Root mean square error of every measured position over the pieces, by model, in the position's unit."""
    pieces, simulator = models["nominal"].pieces, models["nominal"].problem.augmented.simulator
    rows = pieces.state.shape[1] - RUN_IN - 1
    fields = [(i, f) for i, f in enumerate(simulator.schema.outputs) if f.kind in ("position", "angle")]
    residuals = {name: run.residuals for name, run in models.items()}
    errors = {name: np.sqrt(np.mean(np.square(e, dtype=float), axis=(0, 1))) for name, e in residuals.items()}
    return {
        "seconds": rows * simulator.time_step, "pieces": len(pieces.row),
        "positions": [
            {"name": f.name, "unit": f.unit, "errors": {name: float(e[i]) for name, e in errors.items()}}
            for i, f in fields
        ],
    }  # fmt: skip
