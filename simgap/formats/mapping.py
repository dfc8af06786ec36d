"""Bags and tables of one's own robot into recordings, by a mapping file: where every column comes from."""

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from simgap import resample
from simgap.formats.recordings import LARGEST, checked, write_recording
from simgap.formats.sessions import TABLES
from simgap.formats.tables import read_table
from simgap.formats.validation import check
from simgap.formats.yaml_files import read_yaml
from simgap.recordings import HISTORY
from simgap.resample import Stream
from simgap.types import ConfigError, RecordingError, Schema

_LINES, _LINE = 20, 1000  # lines, and characters in each, of a message of a mapping file


class _Block(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Column(_Block):
    """Where a column of the schema comes from."""

    topic: str = Field("", description="Of a bag.")
    field: str = Field("", description="Of its messages, like pose.pose.position.x or data.0; a quaternion for a yaw.")
    column: str = Field("", description="Of a table.")
    unit: str = Field("", description="Of the values; empty: the schema's.")
    frame: Literal["world", "body"] | None = Field(None, description="Of the values; empty: the schema's.")
    sign: Literal[1, -1] = Field(1, description="-1 where the robot counts the other way round.")
    time: Literal["received", "header"] | None = Field(None, description="Of a bag's messages; empty: the mapping's.")

    @model_validator(mode="after")
    def _one_place(self) -> "Column":
        if bool(self.column) == bool(self.topic) or bool(self.topic) != bool(self.field):
            raise ValueError("give topic and field, for a bag, or column, for a table")
        if self.column and self.time:
            raise ValueError("`time` is of a bag's messages; a table has one column of stamps, `time: {column: ...}`")
        return self


class Time(_Block):
    """Where stamps come from."""

    bag: Literal["received", "header"] = Field("received", description="When a message came in, or its header's stamp.")
    column: str = Field("", description="Of a table.")
    unit: str = Field("s", description="Of a table's.")


class MappingFile(_Block):
    """A mapping file."""

    rate_hz: float = Field(gt=0, le=10_000, description="Rows a second.")
    longest_gap_s: float = Field(
        gt=0, allow_inf_nan=False, description="A session is cut where a column of the state pauses for longer."
    )
    time: Time = Time()  # type: ignore[call-arg]
    columns: dict[str, Column]


def read_mapping(path: Path, schema: Schema) -> MappingFile:
    """The mapping file; ConfigError names what is wrong in it."""
    values = read_yaml(path)
    try:
        mapping = check(MappingFile, values)
        _check_columns(mapping, schema)
    except ConfigError as error:
        lines = str(error).splitlines()
        more = [f"  and {len(lines) - _LINES} more"] if len(lines) > _LINES else []
        raise ConfigError(f"{path}: " + "\n".join([line[:_LINE] for line in lines[:_LINES]] + more)) from None
    return mapping


def _check_columns(mapping: MappingFile, schema: Schema) -> None:
    fields = {f.name: f for f in (*schema.state, *schema.command)}
    if set(mapping.columns) != set(fields):
        missing, unknown = sorted(fields.keys() - mapping.columns), sorted(mapping.columns.keys() - fields)
        told = [
            f"{what} {', '.join(names)}" for what, names in (("lacks", missing), ("has the unknown", unknown)) if names
        ]
        raise ConfigError(f"columns {' and '.join(told)}; it must have {', '.join(fields)}, each once.")
    for name, column in mapping.columns.items():
        try:
            resample.factor(column.unit or fields[name].unit, fields[name].unit)
        except ConfigError as error:
            raise ConfigError(f"columns.{name}.unit: {error}") from None
        if column.frame and column.frame != fields[name].frame and fields[name] in schema.command:
            raise ConfigError(f"columns.{name}.frame: commands are in the frame of the schema, {fields[name].frame}. "
                              "Give them so.")  # fmt: skip


def import_session(path: Path, name: str, mapping: MappingFile, schema: Schema, out: Path) -> dict[str, int]:
    """A bag or table as recordings in `out`, a piece for every part without a gap; returns rows by session.

    Raises SimgapError that names the file where it cannot be used.
    """
    try:
        streams = _streams(path, mapping, schema)
        pieces = resample.align(schema, streams, mapping.rate_hz, mapping.longest_gap_s)
        body = {n for n, column in mapping.columns.items() if column.frame == "body"}
        pieces = [resample.to_world(schema, piece, body) for piece in pieces]
    except RecordingError as error:
        raise RecordingError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    least = HISTORY + 2
    pieces = [piece for piece in pieces if len(piece["time_s"]) >= least]
    if not pieces:
        raise RecordingError(
            f"{path}: no part of it without a gap above {mapping.longest_gap_s:g} s has {least} rows at "
            f"{mapping.rate_hz:g} Hz. Raise longest_gap_s, or leave the session out."
        )
    rows = {}
    for k, piece in enumerate(pieces, 1):
        session = name if len(pieces) == 1 else f"{name}_{k}"
        write_recording(out, checked(path, schema, piece)._replace(name=session), schema)
        rows[session] = len(piece["time_s"])
    return rows


def _streams(path: Path, mapping: MappingFile, schema: Schema) -> dict[str, Stream]:
    """Every column with its stamps, in the schema's units; the earliest stamp is 0."""
    raw = _of_table(path, mapping) if path.suffix.lower() in TABLES else _of_bag(path, mapping)
    fields = {f.name: f for f in (*schema.state, *schema.command)}
    streams = {}
    for name, (time, values) in raw.items():
        if not len(time):
            raise RecordingError(f"column {name} has no values. Look at its topic or column in the mapping file.")
        column = mapping.columns[name]
        late = np.flatnonzero(~np.isfinite(time))
        if late.size:
            raise RecordingError(f"column {name}: value {late[0] + 1} of {len(time)} has the time stamp "
                                 f"{time[late[0]]}; every stamp must be a finite number. Cut the session "
                                 "there.")  # fmt: skip
        scale = column.sign * resample.factor(column.unit or fields[name].unit, fields[name].unit)
        order = np.argsort(time, kind="stable")
        time, values = time[order], values[order]
        fresh = np.append(np.diff(time) > 0, True)  # of several values with one stamp, the last
        bad = np.flatnonzero(~(np.abs(values) <= LARGEST))
        if bad.size:
            raise RecordingError(f"column {name}: value {bad[0] + 1} of {len(values)} is {values[bad[0]]:g}; every "
                                 f"value must be a number of at most {LARGEST:.1e}. Cut the session "
                                 "there.")  # fmt: skip
        streams[name] = Stream(time[fresh], scale * values[fresh])
    zero = min(s.time_s[0] for s in streams.values())
    return {name: Stream(s.time_s - zero, s.values) for name, s in streams.items()}


def _of_table(path: Path, mapping: MappingFile) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    wanted = {"time_s": mapping.time.column} | {name: c.column for name, c in mapping.columns.items()}
    if not all(wanted.values()):
        lacking = ", ".join(name for name, column in wanted.items() if not column)
        raise ConfigError(f"{path}: is a table, and the mapping has no `column` for {lacking}. Add it.")
    table = read_table(path, list(dict.fromkeys(wanted.values())))
    time = table[mapping.time.column] * resample.factor(mapping.time.unit, "s")
    found = {}
    for name, column in mapping.columns.items():
        there = ~np.isnan(table[column.column])  # sensors of other rates leave blanks
        found[name] = (time[there], table[column.column][there])
    return found


def _of_bag(path: Path, mapping: MappingFile) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    try:
        from simgap.formats import bags
    except ImportError as error:
        raise ConfigError(f"{path}: is a bag, and the readers of bags are not installed ({error}). Install them: "
                          "pip install 'simgap[bags]'.") from None  # fmt: skip
    wanted: dict[str, bags.Wanted] = {}
    for name, column in mapping.columns.items():
        if not column.topic:
            raise ConfigError(f"{path}: is a bag, and the mapping names no topic for {name}. Add `topic` and `field`.")
        wanted[name] = bags.Wanted(column.topic, column.field, (column.time or mapping.time.bag) == "header")
    return bags.columns(path, wanted)
