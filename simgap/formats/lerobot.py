"""LeRobot data sets, versions 2 and 3, read without LeRobot: an episode is a session.

A column is named by its feature and entry, as `observation.state.shoulder_pan.pos`; an entry without a name by its
number, as `action.0`; a feature of one number by the feature alone, as `timestamp`. Videos are ignored.
"""

import math
import reprlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from simgap.formats.column_names import nearest, unused
from simgap.formats.documents import read_json
from simgap.formats.mapping import FASTEST_HZ
from simgap.formats.tables import Columns
from simgap.types import MOST_ROWS, RecordingError

EPISODE, FRAME, STAMP = "episode_index", "frame_index", "timestamp"
MOST_ENTRIES = 10_000
"""Maximum entries of a feature. Each becomes a column, and a CSV file has at most as many; robots have some hundred."""
SLOWEST_HZ = 0.001
"""Minimum frames a second: one in a quarter of an hour."""


class Episode(NamedTuple):
    """The name of an episode, and the function that reads its columns."""

    name: str
    read: Callable[[], Columns]


class _Place(NamedTuple):
    """A column: its feature, and its entry there; None for a feature of one number."""

    feature: str
    entry: int | None


def episodes(root: Path, wanted: Sequence[str]) -> Iterator[Episode]:
    """The episodes of a data set, by their number; each reads the wanted columns.

    Raises RecordingError where the data set is of another version or lacks a column. A damaged file yields an episode
    that raises it when it is read.
    """
    places, fps = _places(root, wanted)
    files = sorted((root / "data").rglob("*.parquet"))
    if not files:
        raise RecordingError(f"{root}: has no Parquet file in data/. Download the data set whole.")
    for path in files:
        features = list(dict.fromkeys([EPISODE, FRAME, *(place.feature for place in places.values())]))
        try:
            table = pq.read_table(path, columns=features)
            numbers = _numbers(table)
        except (pa.ArrowException, OSError, KeyError, ValueError) as error:
            yield Episode(path.stem, partial(_refuse, path, error))
            continue
        for number in numbers:
            rows = table.filter(pc.field(EPISODE) == number)
            yield Episode(f"episode_{number:06d}", partial(_columns, path, rows, places, fps))


def described(root: Path) -> tuple[dict[str, _Place], float]:
    """The columns of a data set by name, from the features in meta/info.json; and frames a second."""
    info = read_json(root / "meta" / "info.json")
    try:
        version, features, fps = str(info["codebase_version"]), info["features"], _rate(info["fps"])
        there = {name: place for feature, entry in features.items() for name, place in _entries(feature, entry)}
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        reason = str(error) if isinstance(error, ValueError) else repr(error)
        raise RecordingError(
            f"{root}/meta/info.json: describes no LeRobot data set ({reason}). Download the data set whole."
        ) from None
    if version.lstrip("v").split(".")[0] not in ("2", "3"):
        raise RecordingError(f"{root}: is a LeRobot data set of version {version}; 2 and 3 are read. Convert it with "
                             "LeRobot's own script.")  # fmt: skip
    return there, fps


def _rate(fps: Any) -> float:
    """Frames a second as a number; ValueError where it is not a plausible one."""
    try:
        rate = float(fps)
    except (TypeError, ValueError, OverflowError):
        rate = math.nan
    if not SLOWEST_HZ <= rate <= FASTEST_HZ:
        raise ValueError(f"fps is {reprlib.repr(fps)}; it must be a number from {SLOWEST_HZ:g} to {FASTEST_HZ:,}")
    return rate


def _places(root: Path, wanted: Sequence[str]) -> tuple[dict[str, _Place], float]:
    """Where the wanted columns are; and frames a second."""
    there, fps = described(root)
    missing = [name for name in wanted if name not in there]
    if missing:
        raise RecordingError(f"{root}: has no column {', '.join(missing)}{nearest(missing, there)}. "
                             f"{unused(there, wanted)} Correct the mapping file.")  # fmt: skip
    return {name: there[name] for name in wanted}, fps


def _entries(feature: str, described: dict[str, Any]) -> Iterator[tuple[str, _Place]]:
    """Names and places of a feature's numbers; nothing for images, videos and texts."""
    if described["dtype"] in ("image", "video", "string") or len(described["shape"]) != 1:
        return
    (size,) = described["shape"]
    if type(size) is not int or not 1 <= size <= MOST_ENTRIES:
        raise ValueError(
            f"the shape of {feature!r:.100} is [{reprlib.repr(size)}]; it must be one number from 1 to {MOST_ENTRIES:,}"
        )
    names = described.get("names")
    if isinstance(names, dict):  # {"motors": [...]}
        names = [name for group in names.values() for name in group]
    if names is None or len(set(names)) != size:  # equal names are ambiguous
        names = range(size)
    if size == 1:
        yield feature, _Place(feature, None)
    yield from ((f"{feature}.{name}", _Place(feature, i)) for i, name in enumerate(names))


def _numbers(table: pa.Table) -> np.ndarray:
    """The episode numbers in a file; ValueError where they are not integers."""
    column = table[EPISODE]
    if not pa.types.is_integer(column.type) or column.null_count:
        blank = f" and {column.null_count} blanks" if column.null_count else ""
        raise ValueError(f"{EPISODE} holds values of type {column.type}{blank}; all must be whole numbers")
    return np.unique(column.to_numpy())


def _columns(path: Path, table: pa.Table, places: dict[str, _Place], fps: float) -> Columns:
    """Columns of an episode's rows; RecordingError where the file does not hold what info.json says."""
    if len(table) > MOST_ROWS:
        raise RecordingError(f"{path}: an episode has more than {MOST_ROWS:,} rows, the most of a session.")
    try:
        rows = {place.feature: _rows(table[place.feature]) for place in places.values()}
        if STAMP in rows:
            rows[STAMP] = _exact(rows[STAMP], _rows(table[FRAME]) / fps)
        return {name: rows[place.feature][:, place.entry or 0] for name, place in places.items()}
    except (pa.ArrowException, KeyError, IndexError, TypeError, ValueError) as error:
        raise _damaged(path, error) from None


def _rows(column: pa.ChunkedArray) -> np.ndarray:
    """A column of numbers, or of lists of equal length, as a matrix."""
    values = column.combine_chunks()
    if pa.types.is_list(values.type) or pa.types.is_large_list(values.type) or pa.types.is_fixed_size_list(values.type):
        return values.flatten().to_numpy(zero_copy_only=False).astype(np.float64).reshape(len(values), -1)
    return values.to_numpy(zero_copy_only=False).astype(np.float64)[:, None]


def _exact(stamps: np.ndarray, even: np.ndarray) -> np.ndarray:
    """Stamps of evenly spaced frames where these agree in single precision, which loses 1 ms in three hours."""
    return np.where(np.abs(stamps - even) <= 2 * np.spacing(np.float32(stamps)), even, stamps)


def _refuse(path: Path, error: Exception) -> Columns:
    raise _damaged(path, error)


def _damaged(path: Path, error: Exception) -> RecordingError:
    line = next(iter(str(error).splitlines()), type(error).__name__)
    return RecordingError(f"{path}: is no file of a LeRobot data set ({line}). Download or record it again.")
