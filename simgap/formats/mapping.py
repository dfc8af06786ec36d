"""Mapping files: where each column of a robot's recordings comes from, in bags, tables and LeRobot data sets."""

import math
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from simgap import resample
from simgap.formats.column_names import listed, nearest
from simgap.formats.validation import NUMBER, check
from simgap.formats.yaml_files import read_yaml
from simgap.types import ConfigError, Schema

_LINES, _LINE = 20, 1000  # lines, and characters in each, of a message of a mapping file


Number = Annotated[float, NUMBER]
PERCENT = "percent"
"""Unit of values that are shares of a range."""
FASTEST_HZ = 10_000
"""Maximum rows a second; logs of robots have up to a thousand, rarely more."""


class _Block(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Column(_Block):
    """Where a column of the schema comes from."""

    topic: str = Field("", description="Of a bag.")
    field: str = Field("", description="Of its messages, like pose.pose.position.x or data.0, or a quaternion.")
    angle: Literal["yaw", "pitch", "roll"] = Field("yaw", description="Which one of a quaternion is taken.")
    column: str = Field(
        "", description="Of a table; of a LeRobot data set, a feature and its entry, joined by a point."
    )
    unit: str = Field("", description="Of the values; empty: the schema's.")
    scale: Number | None = Field(None, description="In place of a unit: what the values are multiplied by.")
    range: tuple[Number, Number] | None = Field(
        None, description="With the unit percent: what 0 and 100 percent are, in the schema's unit."
    )
    frame: Literal["world", "body"] | None = Field(None, description="Of the values; empty: the schema's.")
    sign: Literal[1, -1] = Field(1, description="-1 where the robot counts the other way round.")
    time: Literal["received", "header"] | None = Field(None, description="Of a bag's messages; empty: the mapping's.")

    @model_validator(mode="after")
    def _one_place(self) -> "Column":
        if bool(self.column) == bool(self.topic) or bool(self.topic) != bool(self.field):
            raise ValueError("give topic and field, for a bag, or column, for a table")
        if self.unit and self.scale is not None:
            raise ValueError("give `unit` or `scale`, not both")
        if (self.unit == PERCENT) != (self.range is not None):
            raise ValueError("give `unit: percent` and `range: [what 0 is, what 100 is]` together, or neither")
        if self.range and not 0 < abs(self.range[1] - self.range[0]) < math.inf:
            raise ValueError("`range` must be two different numbers, [what 0 is, what 100 is]")
        if self.scale == 0:
            raise ValueError("`scale` must not be 0")
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

    rate_hz: Number = Field(gt=0, le=FASTEST_HZ, description="Rows a second.")
    longest_gap_s: Number = Field(gt=0, description="A session is cut where a column of the state pauses for longer.")
    time: Time = Time()  # type: ignore[call-arg]
    columns: dict[str, Column]

    def factors(self, schema: Schema) -> dict[str, float]:
        """The factor by which the values of each column are multiplied."""
        units = {f.name: f.unit for f in (*schema.state, *schema.command)}
        return {name: column.sign * _factor(column, units[name]) for name, column in self.columns.items()}

    def offsets(self) -> dict[str, float]:
        """The offset that is then added to the values of each column."""
        return {name: column.sign * column.range[0] if column.range else 0.0 for name, column in self.columns.items()}


def _factor(column: Column, wanted: str) -> float:
    if column.range is not None:
        return (column.range[1] - column.range[0]) / 100
    return resample.factor(column.unit or wanted, wanted) if column.scale is None else column.scale


def read_mapping(path: Path) -> MappingFile:
    """The mapping file; ConfigError names what is wrong in it."""
    values = read_yaml(path)
    try:
        return check(MappingFile, values)
    except ConfigError as error:
        raise _shortened(path, error) from None


def check_columns(path: Path, mapping: MappingFile, schema: Schema, known: Collection[str]) -> None:
    """ConfigError unless the mapping file at `path` gives the source of each column of the schema, and of no other.
    `known`: all columns that its simulator could have."""
    try:
        _check_columns(mapping, schema, known)
    except ConfigError as error:
        raise _shortened(path, error) from None


def _shortened(path: Path, error: ConfigError) -> ConfigError:
    lines = str(error).splitlines()
    more = [f"  and {len(lines) - _LINES} more"] if len(lines) > _LINES else []
    return ConfigError(f"{path}: " + "\n".join([line[:_LINE] for line in lines[:_LINES]] + more))


def _check_columns(mapping: MappingFile, schema: Schema, known: Collection[str]) -> None:
    fields = {f.name: f for f in (*schema.state, *schema.command)}
    if set(mapping.columns) != set(fields):
        missing, unknown = sorted(fields.keys() - mapping.columns), sorted(mapping.columns.keys() - fields)
        wrong = [
            f"{what} {', '.join(names)}" for what, names in (("lacks", missing), ("has the unknown", unknown)) if names
        ]
        needs = f"it must have {listed(missing)} as well" if missing else "leave these out, or correct their names"
        raise ConfigError(f"columns {' and '.join(wrong)}; {needs}{nearest(unknown, known)}. "
                          f"Columns of the simulator: {listed(known)}.")  # fmt: skip
    _check_unit("time.unit", partial(resample.factor, mapping.time.unit, "s"))
    for name, column in mapping.columns.items():
        _check_unit(f"columns.{name}.unit", partial(_factor, column, fields[name].unit))
        if column.frame and column.frame != fields[name].frame and fields[name] in schema.command:
            raise ConfigError(f"columns.{name}.frame: commands are in the frame of the schema, {fields[name].frame}. "
                              "Give them so.")  # fmt: skip


def _check_unit(key: str, factor: Callable[[], float]) -> None:
    """ConfigError that names the key, unless its unit can be converted to the schema's."""
    try:
        factor()
    except ConfigError as error:
        raise ConfigError(f"{key}: {error}") from None
