"""LeRobot data sets of a robot with a model file: columns are found by the names of joints, units are given."""

from collections.abc import Mapping
from pathlib import Path

from simgap.formats import lerobot
from simgap.formats.column_names import listed, nearest
from simgap.formats.mapping import PERCENT, Column, MappingFile
from simgap.types import ConfigError, Field, RecordingError, Schema

SIGNED = "signed_percent"
"""Unit of values from -100 to 100 over a joint's range."""
UNITS = ("deg", "rad", "m", "mm", PERCENT, SIGNED)
"""Units that positions and commands of joints may have; percents are of the joint's range in the model."""
EVERY = ""
"""Key of the unit of all joints that have none of their own."""
LONGEST_GAP = 5.0
"""A session is cut at gaps longer than this many intervals."""
Ranges = Mapping[str, tuple[float, float]]


def mapping_of(root: Path, schema: Schema, ranges: Ranges, units: Mapping[str, str]) -> MappingFile:
    """The mapping of a data set whose columns are named like joints of the model.

    `observation.state.<joint>` or `<joint>.pos` is a position, `<joint>.vel` a velocity, and `action.<actuator>` or
    `<actuator>.pos` a command. units: one of `UNITS` by joint, and under `EVERY` for all other joints.

    Raises RecordingError where no column is a joint's position, ConfigError where a unit is missing or impossible.
    """
    there, fps = lerobot.described(root)
    bodies = list(dict.fromkeys(f.body for f in schema.state if f.body))
    if unknown := [joint for joint in units if joint not in (EVERY, *bodies)]:
        raise ConfigError(f"--units names {listed(unknown)}, which is no joint of the model{nearest(unknown, bodies)}. "
                          f"It has {listed(bodies)}.")  # fmt: skip
    columns = {}
    for field in (*schema.state, *schema.command):
        column = next((name for name in _names(field, field in schema.command) if name in there), None)
        if column is not None and not _is_share_of_speed(field, units):
            columns[field.name] = _column(root, field, column, ranges, units)
    if not any(f.name in columns and f.kind == "position" for f in schema.state):
        raise RecordingError(
            f"{root}: no column is called like a joint of the model, observation.state.{schema.state[0].body}.pos; "
            f"there are {listed(there)}. Give a mapping file, --mapping."
        )
    return MappingFile(rate_hz=fps, longest_gap_s=LONGEST_GAP / fps, columns=columns)


def _names(field: Field, commanded: bool) -> list[str]:
    """Names that a column may have in a data set."""
    if commanded:
        return [f"action.{field.name.removeprefix('cmd_')}{end}" for end in (".pos", "")]
    ends = {"position": (".pos", ""), "velocity": (".vel",)}.get(field.kind, ())
    return [f"observation.state.{field.body}{end}" for end in ends]


def _unit(field: Field, units: Mapping[str, str]) -> str:
    return units.get(field.body) or units.get(EVERY, "")


def _is_share_of_speed(field: Field, units: Mapping[str, str]) -> bool:
    """Whether it is a velocity in percent of a range, a unit that nobody uses; the velocity is then estimated."""
    return field.kind == "velocity" and _unit(field, units) in (PERCENT, SIGNED)


def _column(root: Path, field: Field, column: str, ranges: Ranges, units: Mapping[str, str]) -> Column:
    unit = _unit(field, units)
    if not unit:
        raise ConfigError(f"{root}: a LeRobot data set does not say its units. Say --units {', '.join(UNITS)}, of all "
                          f"joints or by joint, as --units deg,{field.body}=percent.")  # fmt: skip
    if unit not in (PERCENT, SIGNED):
        per_second = "/s" if field.kind == "velocity" else ""
        return Column.model_validate({"column": column, "unit": f"{unit}{per_second}"})
    if field.body not in ranges:
        raise ConfigError(f"{root}: {column} is said to be in percent, and the joint {field.body} has no range in the "
                          "model. Give its unit in a mapping file.")  # fmt: skip
    low, high = ranges[field.body]
    ends = (low if unit == PERCENT else (low + high) / 2, high)
    return Column.model_validate({"column": column, "unit": PERCENT, "range": ends})
