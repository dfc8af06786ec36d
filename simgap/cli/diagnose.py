"""`simgap diagnose`: what a simulator leaves out of a folder's recordings."""

import time
from collections.abc import Sequence
from pathlib import Path

from simgap.cli import progress
from simgap.cli.locks import alone
from simgap.diagnosis.diagnose import diagnose
from simgap.formats import diagnoses, peek, purposes
from simgap.formats.documents import as_json
from simgap.formats.folders import make_folder
from simgap.formats.purposes import Folders
from simgap.loading.arrange import arranged
from simgap.loading.load import prepared, started
from simgap.loading.model_files import ModelFile
from simgap.result import Result
from simgap.types import Sessions


def diagnose_folder(folders: Folders, simulator: str | ModelFile, out: Path, seed: int, json: bool) -> None:
    """Diagnose, write to `out`, and print the statement and where the page is; or the statement as JSON."""
    used = prepared(simulator, lambda: peek.in_folders(folders.every))
    given, errors = purposes.read(folders, used.simulator)
    used, sessions = arranged(used, given, say_note)
    label = " and ".join(folder.resolve().name for folder in (folders.recordings, *folders.further))
    say_what_is_read(used.name, label, sessions, errors)
    used = started(used, sessions, say_note)
    make_folder(out)  # before the work, not after it
    with alone(out):
        start = time.perf_counter()
        with progress.steps("diagnosing") as step:
            found = diagnose(used.simulator, used.name, sessions, seed, step)
        result = Result.of(used, sessions, found, errors)
        result.save(out)
    seconds = time.perf_counter() - start
    progress.say(f"\n{summary(result.statement, out, seconds)}")
    if json:
        print(as_json(result.statement))


def say_note(note: str) -> None:
    """What of a model file cannot be diagnosed, or is not as it was given."""
    progress.say(f"note: {note}")


def say_what_is_read(simulator: str, recordings: str, sessions: Sessions, errors: Sequence[str]) -> None:
    """Which files are left out, and how many sessions serve which purpose; names of simulator and recordings."""
    for error in errors:
        progress.say(f"left out: {error}")
    counts = ", ".join(f"{len(found)} {purpose}" for purpose, found in sessions.by_purpose.items() if found)
    progress.say(f"diagnosis of {simulator} on {recordings}: {counts} sessions")


def summary(statement: dict, out: Path, seconds: float) -> str:
    """The statement, where its files are, and how long it took."""
    shown = [("page", diagnoses.PAGE), ("data", diagnoses.STATEMENT), ("commands", diagnoses.EXPERIMENT)]
    if statement.get("patched"):
        shown.append(("model", statement["patched"]["file"]))
    places = "\n".join(f"{what:10}{out / file}" for what, file in shown if (out / file).exists())
    return f"{statement['statement']}\n\n{places}\n({statement['verdict'].replace('_', ' ')}, {seconds:.0f} s)"
