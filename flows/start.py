"""How a stage is started from the command line: `python -m flows.<stage> SOURCE`."""

import argparse
import fcntl
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from flows import running
from simgap.types import SimgapError
from tasks import files, progress
from tasks.params import load_params, read_yaml

PARAMS = Path("params.yaml")
FOLDERS = [Path(name) for name in ("data", "models", "scores", "policies", "tracks", "reports")]
"""What stages write to in the project."""


def main(run: Callable[..., Any]) -> None:
    """Run a stage's flow in the project's folders, with params.yaml; explained errors end it without a traceback.

    With `--overrides` it is a part of the experiment, or another one, which DVC does not know of.
    """
    parser = argparse.ArgumentParser(description=run.__doc__)
    parser.add_argument("source", help="a block of params.yaml's recordings, such as virtual or spot")
    add_overrides(parser)
    arguments = parser.parse_args()
    for folder in FOLDERS:
        files.remove_unfinished(folder)
    guarded(lambda: run(arguments.source, load_params(PARAMS, *read_overrides(arguments)), Path()))


@contextmanager
def alone(root: Path) -> Iterator[None]:
    """Hold a run's folder, and clear it of what a killed run was writing; SimgapError where another process works in
    it."""
    files.make_folder(root)
    with (root / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SimgapError(
                f"{root}: another run of this name is at work there. Wait for it, or give this one another name."
            ) from None
        files.remove_unfinished(root)
        yield


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """The option `--overrides`, as often as one likes."""
    parser.add_argument("--overrides", type=Path, action="append", default=[], help="YAML file merged into params.yaml")


def read_overrides(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """What the files given as `--overrides` hold."""
    return [read_yaml(path) for path in arguments.overrides]


def guarded(work: Callable[[], Any]) -> None:
    """Call `work`; an error that explains itself, or a Prefect server that is gone, ends the process with status 1."""
    progress.quiet_libraries()
    running.end_left_over()
    try:
        if "PREFECT_API_URL" not in os.environ:  # a flow starts a server, which makes it
            files.keep_private(Path(os.environ["PREFECT_HOME"]) / running.DATABASE)
        work()
    except SimgapError as error:
        progress.say(f"error: {error}")
        sys.exit(1)
    except (httpx.HTTPError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and not str(error).startswith("Failed to reach API"):  # Prefect's own words
            raise
        progress.say(
            f"error: Prefect's server does not answer ({error or type(error).__name__}). What is finished is kept. "
            "Start the server (`make up`), or unset PREFECT_API_URL, and give the same command again."
        )
        sys.exit(1)
