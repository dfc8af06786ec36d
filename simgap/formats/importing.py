"""Imports bags, tables and LeRobot data sets of one's own robot as recordings, as a mapping file says."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from simgap import resample
from simgap.formats import lerobot
from simgap.formats.mapping import MappingFile
from simgap.formats.recordings import LARGEST, checked, write_recording
from simgap.formats.sessions import TABLES, is_lerobot
from simgap.formats.tables import Columns, read_table
from simgap.recordings import HISTORY
from simgap.resample import Stream
from simgap.types import ConfigError, RecordingError, Schema

Raw = dict[str, tuple[np.ndarray, np.ndarray]]
"""Stamps [s] and values of every column of the schema, as recorded."""


class Session(NamedTuple):
    """A session to import: its name, its name in messages, and the function that reads it."""

    name: str
    label: str
    read: Callable[[], Raw]


def import_sessions(
    path: Path, name: str, mapping: MappingFile, schema: Schema, out: Path
) -> tuple[dict[str, int], list[RecordingError]]:
    """Write the sessions of a bag, a table or a data set as recordings to `out`. Returns rows by session, and errors.

    Each part of a session without a gap becomes a recording. Raises ConfigError where the mapping does not fit.
    """
    rows: dict[str, int] = {}
    errors: list[RecordingError] = []
    for session in _sessions(path, name, mapping, schema):
        try:
            rows |= _import(session, mapping, schema, out)
        except RecordingError as error:
            message = str(error)
            errors.append(RecordingError(message if str(path) in message else f"{session.label}: {error}"))
    return rows, errors


def _sessions(path: Path, name: str, mapping: MappingFile, schema: Schema) -> Iterator[Session]:
    if is_lerobot(path):
        wanted = _columns(path, mapping, "timestamp")
        _refuse_without_unit(path, mapping, schema)
        for episode in lerobot.episodes(path, list(dict.fromkeys(wanted.values()))):
            read = lambda episode=episode: _raw(episode.read(), wanted, "s", mapping)  # noqa: E731
            yield Session(f"{name}/{episode.name}", f"{path}: {episode.name}", read)
    elif path.suffix.lower() in TABLES:
        wanted = _columns(path, mapping, mapping.time.column)
        unit, columns = mapping.time.unit, list(dict.fromkeys(wanted.values()))
        yield Session(name, str(path), lambda: _raw(read_table(path, columns), wanted, unit, mapping))
    else:
        yield Session(name, str(path), lambda: _of_bag(path, mapping))


def _import(session: Session, mapping: MappingFile, schema: Schema, out: Path) -> dict[str, int]:
    streams = _streams(session.read(), mapping.factors(schema), mapping.offsets())
    pieces = resample.align(schema, streams, mapping.rate_hz, mapping.longest_gap_s)
    body = {n for n, column in mapping.columns.items() if column.frame == "body"}
    pieces = [resample.to_world(schema, piece, body) for piece in pieces]
    least = HISTORY + 2
    pieces = [piece for piece in pieces if len(piece["time_s"]) >= least]
    if not pieces:
        raise RecordingError(
            f"{session.label}: no part of it without a gap above {mapping.longest_gap_s:g} s has {least} rows at "
            f"{mapping.rate_hz:g} Hz. Raise longest_gap_s, or leave the session out."
        )
    rows = {}
    for k, piece in enumerate(pieces, 1):
        name = session.name if len(pieces) == 1 else f"{session.name}_{k}"
        write_recording(out, checked(session.label, schema, piece)._replace(name=name), schema)
        rows[name] = len(piece["time_s"])
    return rows


def _streams(raw: Raw, factors: dict[str, float], offsets: dict[str, float]) -> dict[str, Stream]:
    """Every column with its stamps, in the schema's units; the earliest stamp is 0."""
    streams = {}
    for name, (time, values) in raw.items():
        if not len(time):
            raise RecordingError(f"column {name} has no values. Look at its topic or column in the mapping file.")
        bad = np.flatnonzero(~np.isfinite(time))
        if bad.size:
            raise RecordingError(f"column {name}: value {bad[0] + 1} of {len(time)} has the time stamp "
                                 f"{time[bad[0]]}; every stamp must be a finite number. Cut the session "
                                 "there.")  # fmt: skip
        order = np.argsort(time, kind="stable")
        time, values = time[order], values[order]
        last = np.append(np.diff(time) > 0, True)  # the last of several values with one stamp
        bad = np.flatnonzero(~(np.abs(values) <= LARGEST))
        if bad.size:
            raise RecordingError(f"column {name}: value {bad[0] + 1} of {len(values)} is {values[bad[0]]:g}; every "
                                 f"value must be a number of at most {LARGEST:.1e}. Cut the session "
                                 "there.")  # fmt: skip
        streams[name] = Stream(time[last], factors[name] * values[last] + offsets[name])
    zero = min(s.time_s[0] for s in streams.values())
    return {name: Stream(s.time_s - zero, s.values) for name, s in streams.items()}


def _columns(path: Path, mapping: MappingFile, time: str) -> dict[str, str]:
    """The column of a table for each column of the schema and for the stamps."""
    wanted = {"time_s": mapping.time.column or time} | {name: c.column for name, c in mapping.columns.items()}
    if not all(wanted.values()):
        missing = ", ".join(name for name, column in wanted.items() if not column)
        raise ConfigError(f"{path}: has columns, and the mapping has no `column` for {missing}. Add it.")
    return wanted


def _raw(table: Columns, wanted: dict[str, str], unit: str, mapping: MappingFile) -> Raw:
    time = table[wanted["time_s"]] * resample.factor(unit, "s")
    raw = {}
    for name in mapping.columns:
        values = table[wanted[name]]
        present = ~np.isnan(values)  # sensors with other rates leave blanks
        raw[name] = (time[present], values[present])
    return raw


def _refuse_without_unit(path: Path, mapping: MappingFile, schema: Schema) -> None:
    """ConfigError where a unit is missing: LeRobot stores degrees, radians or percents without saying which."""
    units = {f.name: f.unit for f in (*schema.state, *schema.command)}
    without = [n for n, c in mapping.columns.items() if units[n] != "-" and not c.unit and c.scale is None]
    if without:
        raise ConfigError(
            f"{path}: a LeRobot data set does not say its units, and the mapping gives none for {', '.join(without)}. "
            "Add `unit`, such as deg or rad; for percents `unit: percent` and `range: [at 0, at 100]`, in "
            f"{units[without[0]]}."
        )


def _of_bag(path: Path, mapping: MappingFile) -> Raw:
    try:
        from simgap.formats import bags
    except ImportError as error:
        raise ConfigError(f"{path}: is a bag, and the readers of bags are not installed ({error}). Install them: "
                          "pip install 'simgap[bags]'.") from None  # fmt: skip
    wanted: dict[str, bags.Wanted] = {}
    for name, column in mapping.columns.items():
        if not column.topic:
            raise ConfigError(f"{path}: is a bag, and the mapping names no topic for {name}. Add `topic` and `field`.")
        by_header = (column.time or mapping.time.bag) == "header"
        wanted[name] = bags.Wanted(column.topic, column.field, column.angle, by_header)
    return bags.columns(path, wanted)
