"""`simgap import`: bags, tables and LeRobot data sets of one's own robot into recordings."""

from collections.abc import Mapping
from pathlib import Path

from simgap.cli import progress
from simgap.cli.locks import alone
from simgap.formats import sessions
from simgap.formats.importing import import_sessions
from simgap.formats.joint_names import mapping_of
from simgap.formats.mapping import MappingFile, check_columns, read_mapping
from simgap.formats.peek import Seen
from simgap.formats.recordings import session_name, session_names
from simgap.loading.load import prepared
from simgap.loading.model_files import ModelFile
from simgap.types import RecordingError, Schema

TIME_STEP = 0.02
"""Interval [s] with which a model is looked at before that of the recordings is known: names do not depend on it."""


def import_data_set(source: Path, units: Mapping[str, str], out: Path, simulator: ModelFile) -> None:
    """Every episode of a LeRobot data set of the robot that a model is of, by the names of its joints."""
    mapping = mapping_of(source, *simulator.described(TIME_STEP), units)
    schema = _schema(mapping, simulator)
    check_columns(source, mapping, schema, schema.columns[1:])
    _import(source, mapping, schema, out, simulator)


def import_recordings(source: Path, mapping_file: Path, out: Path, simulator: str | ModelFile) -> None:
    """Every session of `source` as the mapping file says; one that cannot be used is reported, and loses no other."""
    mapping = read_mapping(mapping_file)
    schema = _schema(mapping, simulator)
    known = simulator.columns(1 / mapping.rate_hz) if isinstance(simulator, ModelFile) else schema.columns
    check_columns(mapping_file, mapping, schema, known[1:])  # without the time, which has a key of its own
    _import(source, mapping, schema, out, simulator)


def _schema(mapping: MappingFile, simulator: str | ModelFile) -> Schema:
    """Of the recordings that a mapping makes."""
    return prepared(simulator, lambda: Seen(tuple(mapping.columns), 1 / mapping.rate_hz)).simulator.schema.measured


def _import(source: Path, mapping: MappingFile, schema: Schema, out: Path, simulator: str | ModelFile) -> None:
    paths = sessions.sources(source)
    rows: dict[str, int] = {}
    errors: list[RecordingError] = []
    with alone(out):
        for path in paths:
            name = session_name(source if path != source else source.parent, path)
            try:
                written, bad = import_sessions(path, name, mapping, schema, out)
            except RecordingError as error:
                written, bad = {}, [error]
            rows |= written
            errors += bad
    for error in errors:
        progress.say(f"left out: {error}")
    if not rows:
        raise RecordingError(f"{source}: none of its sessions can be used; the reasons are above.")
    others = [name for name in session_names(out) if name not in rows]
    if others:
        progress.say(f"warning: {out} holds {', '.join(others)} as well, which this import did not write. Remove what "
                     "is not to be used: a session that was cut otherwise before would be there twice.")  # fmt: skip
    progress.say(f"{len(rows)} sessions, {sum(rows.values()):,} rows at {mapping.rate_hz:g} Hz in {out}\n"
                 f"Look at them with: simgap check {out} --simulator {simulator}")  # fmt: skip
