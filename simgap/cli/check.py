"""`simgap check`: what a folder of recordings holds and what looks wrong in it."""

from pathlib import Path

from simgap.cli import progress
from simgap.formats import peek
from simgap.formats.folders import make_folder
from simgap.formats.recordings import printable
from simgap.loading.load import prepared
from simgap.loading.model_files import ModelFile
from simgap.page import check


def check_folder(folder: Path, simulator: str | ModelFile, out: Path) -> None:
    """Print what looks wrong, and write the page."""
    used = prepared(simulator, lambda: peek.in_folders([folder])).simulator
    checked = check.check(folder, used)
    make_folder(out)
    path = check.write(out, printable(folder.resolve().name), checked, used)
    for error in checked.left_out:
        progress.say(f"left out: {error}")
    for finding in checked.findings:
        progress.say(f"- {finding}")
    rows = sum(len(r.time_s) for r in checked.sessions)
    progress.say(
        f"{len(checked.sessions)} sessions, {rows:,} rows; {len(checked.findings) or 'no'} findings\npage {path}"
    )
