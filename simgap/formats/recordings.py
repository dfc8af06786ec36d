"""Reads, checks and writes recordings: the sessions of a folder."""

import hashlib
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from simgap.formats.atomic import replacing
from simgap.formats.pickles import pickle_columns
from simgap.formats.sessions import TABLES, session_files
from simgap.formats.tables import Columns, table_columns, unreadable
from simgap.recordings import check_recording
from simgap.types import MOST_ROWS, Recording, RecordingError, Schema

LARGEST = float(np.sqrt(np.finfo(np.float32).max / MOST_ROWS))
"""Maximum absolute value: the squares of a session's values then have a finite sum in single precision, in which the
diagnosis and the learning compute."""
_SHOWN = 20  # files that are named where none can be used


def read_recordings(
    folder: Path, schema: Schema, time_step: float, patterns: Sequence[str] = ("**/*",)
) -> tuple[list[Recording], list[RecordingError]]:
    """Every session under `folder` that matches a glob pattern, by relative path, and why others cannot be used.

    A session is a CSV, Parquet or pickle file; its name is its path in the folder without the suffix. `time_step` [s]
    is the interval between rows of pickles, which have no time stamps. An error names file, column, row and remedy,
    and does not affect other sessions. Raises RecordingError where the folder has no usable session at all.
    """
    recordings: list[Recording] = []
    errors: list[RecordingError] = []
    seen: dict[str, Path] = {}
    paths = session_files(folder, patterns)
    for path in paths:
        name = session_name(folder, path)
        try:
            if name in seen:
                raise RecordingError(
                    f"{path}: the session {name} is in {seen[name]} already; a session is one file. "
                    "Remove or rename one of the two."
                )
            seen[name] = path
            recordings.append(checked(path, schema, _columns(path, schema, time_step))._replace(name=name))
        except RecordingError as error:
            errors.append(RecordingError(printable(str(error))))
    if not recordings:
        reasons = "\n".join(f"  {error}" for error in errors[:_SHOWN])
        more = f"\n  and {len(errors) - _SHOWN} more" if len(errors) > _SHOWN else ""
        raise RecordingError(
            printable(f"{folder}: none of its {len(paths)} session files can be used:\n{reasons}{more}")
        )
    return recordings, errors


class _WithoutCommands(Schema):
    """The schema of a machine without commands, as `check_recording` accepts it: with one command that has no column.

    `simgap.recordings` does not handle this case, as a change there would invalidate every trained model.
    """

    @property
    def columns(self) -> tuple[str, ...]:
        return ("time_s", *(f.name for f in self.state))


def checked(path: Path | str, schema: Schema, columns: Columns) -> Recording:
    """Columns as a usable recording; RecordingError that names file, column, row and remedy.

    Its state holds the recorded columns; the schema may have more states.
    """
    there = schema.measured
    if there.command:
        recording = check_recording(there, str(path), columns)
    else:
        recording = check_recording(_WithoutCommands(there.state, there.state[:1], there.mounts), str(path), columns)
        recording = recording._replace(command=np.empty((len(recording.time_s), 0)))
    for name in schema.columns:
        beyond = np.flatnonzero(np.abs(columns[name]) > LARGEST)
        if beyond.size:
            raise RecordingError(
                f"{path}: column {name}, row {beyond[0] + 1} is {columns[name][beyond[0]]:g}; no value may exceed "
                f"{LARGEST:.1e}, or its square is lost in single precision ({beyond.size} such rows). Look for a wrong "
                "unit or a damaged value; convert the column, or cut the session there."
            )
    return recording


def digest(recordings: Sequence[Recording]) -> str:
    """16 hexadecimal digits that identify sessions by their numbers."""
    mark = hashlib.sha256()
    for recording in recordings:
        for values in (recording.time_s, recording.state, recording.command):
            mark.update(f"{values.shape}".encode())
            mark.update(np.ascontiguousarray(values, np.float64).tobytes())
    return mark.hexdigest()[:16]


def printable(text: str) -> str:
    """A text that can be printed and written: bytes of a file name that are not UTF-8 become `\\udcff`."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def session_name(folder: Path, path: Path) -> str:
    """A session's name: its path below the folder without the suffix, printable."""
    return printable(path.relative_to(folder).with_suffix("").as_posix())


def session_names(folder: Path) -> list[str]:
    """Names of the sessions under a folder, whether they can be used or not."""
    return [session_name(folder, path) for path in session_files(folder)]


def write_recording(folder: Path, recording: Recording, schema: Schema) -> Path:
    """Write a session as Parquet in the documented format, at its name below `folder`; returns the path.

    Columns are those of the schema as 64-bit floats, in the schema's units. Raises RecordingError where the name would
    leave the folder.
    """
    path = folder / f"{_relative_name(recording.name)}.parquet"
    values = np.column_stack([recording.time_s, recording.state, recording.command]).astype(np.float64)
    table = pa.table(dict(zip(schema.columns, values.T, strict=True)))
    with replacing(path) as temporary:
        # When the file is read, the checksum reveals damaged values.
        pq.write_table(table, temporary, write_page_checksum=True)
    return path


def _relative_name(name: str) -> str:
    """The session's name, which becomes a path; RecordingError where that leaves the folder or cannot be read back."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or not path.parts or str(path) != name or "\0" in name:
        raise RecordingError(
            f"The session name {name!r} must be a relative path like `day_1/walk`, without `..`: it becomes a file in "
            "the recordings' folder. Rename the session."
        )
    return name


def _columns(path: Path, schema: Schema, time_step: float) -> Columns:
    """The schema's columns that the file has, as numbers."""
    try:
        if not path.is_file():
            raise OSError("it is no regular file, or a link to nothing")
        if path.suffix.lower() in TABLES:
            return table_columns(path, schema)
        return pickle_columns(path, schema, time_step)
    except OSError as error:
        raise unreadable(path, error) from None
