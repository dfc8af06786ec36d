"""A first look at recordings, before their simulator exists: their columns, and the interval between rows."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.formats.sessions import TABLES, session_files
from simgap.formats.tables import column_names, read_table
from simgap.types import RecordingError


class Look(NamedTuple):
    """One session: its columns, and the median interval between its rows [s] (NaN if unknown)."""

    columns: Sequence[str]
    interval: float


class Seen(NamedTuple):
    """Columns that more than half of the sessions have, in the order of the first; the usual interval of rows [s]."""

    columns: tuple[str, ...]
    time_step: float


def in_folders(folders: Iterable[Path]) -> Seen:
    """What the sessions of several folders have in common; raises as `in_folder` and `seen` do."""
    return seen([look for folder in folders for look in in_folder(folder)])


def in_folder(folder: Path) -> list[Look]:
    """The sessions of a folder that are tables with the column time_s; RecordingError where there are none."""
    looks, wrong = [], []
    for path in session_files(folder):
        if path.suffix.lower() in TABLES:
            try:
                looks.append(Look(column_names(path), _interval(read_table(path, ["time_s"])["time_s"])))
            except RecordingError as error:
                wrong.append(str(error))
    if not looks:
        raise RecordingError(wrong[0] if wrong else f"{folder}: holds no CSV or Parquet file, which have names of "
                             "columns. A model file is only for such recordings.")  # fmt: skip
    return looks


def of_table(table: Any) -> Look:
    """A session in memory, a DataFrame or a dictionary; RecordingError where it has no column time_s."""
    columns = [str(c) for c in (table.columns if hasattr(table, "columns") else table)]
    if "time_s" not in columns:
        raise RecordingError("A session must have the column time_s, the time of each row in seconds; this one has "
                             f"{', '.join(columns) or 'none'}.")  # fmt: skip
    return Look(columns, _interval(np.asarray(table["time_s"], float)))


def seen(looks: Sequence[Look]) -> Seen:
    """What sessions have in common; RecordingError where no interval is known."""
    count = Counter(name for look in looks for name in dict.fromkeys(look.columns))
    usual = tuple(name for name, sessions in count.items() if 2 * sessions > len(looks))
    known = [look.interval for look in looks if look.interval > 0]
    if not known:
        raise RecordingError("No session has two rows at different times (column time_s), so that the interval between "
                             "rows is unknown. Give recordings with increasing times.")  # fmt: skip
    return Seen(usual, float(f"{np.median(known):.6g}"))


def _interval(time_s: Float[np.ndarray, " T"]) -> float:
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.nan
