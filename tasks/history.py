"""A session's table as the rows that models take, each with the commands before it."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from simgap.recordings import HISTORY
from simgap.types import RecordingError, Schema


class Rows(NamedTuple):
    """States, commands from `HISTORY` rows before to the row itself, and whether all of these were recorded."""

    state: Float[np.ndarray, "n s"]
    commands: Float[np.ndarray, "n 3 u"]
    complete: Bool[np.ndarray, " n"]


def rows(schema: Schema, table: pd.DataFrame) -> Rows:
    """The rows of one session with the columns of a recording file, in order of time.

    Where there are commands, the first `HISTORY` rows are not complete: zeros stand for the commands before them.
    Raises RecordingError where a column is missing, or time does not increase from row to row.
    """
    missing = [name for name in schema.columns if name not in table]
    if missing:
        raise RecordingError(
            f"The table lacks {', '.join(missing)}; it must have the columns of a recording: "
            f"{', '.join(schema.columns)}. Rename or add the columns."
        )
    backwards = np.flatnonzero(np.diff(table["time_s"].to_numpy(float)) <= 0)
    if backwards.size:
        raise RecordingError(
            f"time_s does not increase after row {backwards[0] + 1} of the table. Sort the rows, and give one session "
            "at a time."
        )
    state, sent = (table[[f.name for f in fields]].to_numpy(np.float32) for fields in (schema.state, schema.command))
    padded = np.concatenate([np.zeros((HISTORY, sent.shape[1]), np.float32), sent])
    commands = np.stack([padded[k : k + len(sent)] for k in range(HISTORY + 1)], axis=1)
    return Rows(state, commands, np.arange(len(sent)) >= (HISTORY if schema.command else 0))


def example(schema: Schema) -> pd.DataFrame:
    """The shortest table of which a row is complete, at rest."""
    table = pd.DataFrame(np.zeros((HISTORY + 1, len(schema.columns))), columns=list(schema.columns))
    return table.assign(time_s=np.arange(HISTORY + 1.0))
