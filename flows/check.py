"""`simgap check`: what a folder of recordings holds and what looks wrong in it. It needs neither Prefect nor MLflow."""

from pathlib import Path

from tasks import check, progress
from tasks.files.folders import make_folder
from tasks.files.recordings import printable
from tasks.simulators import loading


def check_folder(folder: Path, simulator: str, out: Path) -> None:
    """Print what looks wrong, and write the page."""
    used = loading.load(simulator)
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
