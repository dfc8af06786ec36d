"""`simgap import`: bags, tables and LeRobot data sets of one's own robot into recordings."""

from pathlib import Path

from simgap.cli import progress
from simgap.cli.locks import alone
from simgap.formats import sessions
from simgap.formats.importing import import_sessions
from simgap.formats.mapping import read_mapping
from simgap.formats.recordings import session_name, session_names
from simgap.loading.load import load
from simgap.types import RecordingError


def import_recordings(source: Path, mapping_file: Path, out: Path, simulator: str) -> None:
    """Every session of `source` as the mapping file says; one that cannot be used is reported, and loses no other."""
    schema = load(simulator).schema
    mapping = read_mapping(mapping_file, schema)
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
