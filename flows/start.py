"""How a stage is started from the command line: `python -m flows.<stage> SOURCE`."""

import argparse
import fcntl
import os
import shlex
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx

from flows import running
from simgap.types import ConfigError, SimgapError
from tasks import databases, files, progress
from tasks.params import load_params
from tasks.workspace import Workspace
from tasks.yaml_files import read_yaml

PARAMS = Path("params.yaml")
FOLDERS = [Path(name) for name in ("data", "models", "scores", "policies", "tracks", "reports")]
"""What stages write to in the project."""
_HOLDER_BYTES = 4096


def main(run: Callable[..., Any]) -> None:
    """Run a stage's flow in the project's folders, with params.yaml; explained errors end it without a traceback.

    With `--overrides` it is a part of the experiment, or another one, which DVC does not know of.
    """
    parser = argparse.ArgumentParser(description=run.__doc__)
    parser.add_argument("source", help="a block of params.yaml's recordings, such as virtual or spot")
    add_overrides(parser)
    arguments = parser.parse_args()

    def work() -> None:
        params = load_params(PARAMS, *read_overrides(arguments))
        params.source(arguments.source)
        with held(Workspace(Path(), arguments.source).lock):
            for folder in FOLDERS:
                files.remove_unfinished(folder)
            run(arguments.source, params, Path())

    guarded(work)


@contextmanager
def alone(root: Path, source: str = "") -> Iterator[None]:
    """Hold a run's folder, and in it what belongs to a source, and clear it of what a killed run was writing.

    Raises SimgapError where another process works there.
    """
    with held(root / ".lock"), held(Workspace(root, source).lock) if source else nullcontext():
        files.remove_unfinished(root)
        yield


@contextmanager
def held(lock: Path) -> Iterator[None]:
    """Hold a lock file, which says by whom, as long as the block runs and the process lives.

    Raises SimgapError that names the holder where there is one: it would lose what it is writing.
    """
    files.make_folder(lock.parent)
    try:
        file = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise SimgapError(f"{lock}: cannot be opened ({error.strerror}). Fix its permissions, or delete it.") from None
    try:
        _take(file, lock)
        yield
        _write(file, "")
    finally:
        os.close(file)


def _take(file: int, lock: Path) -> None:
    """Lock the open file, and say in it who did."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.pread(file, _HOLDER_BYTES, 0).decode(errors="replace") or "another process"
        raise SimgapError(
            f"{lock}: held by {holder}. Two commands at work in one folder would delete each other's results. Wait "
            "until that one has ended, end it, or use another workspace or name."
        ) from None
    since = f"{datetime.now():%Y-%m-%d %H:%M:%S}"
    _write(file, f"process {os.getpid()} on {socket.gethostname()} since {since}: {shlex.join(sys.orig_argv)}")


def _write(file: int, holder: str) -> None:
    """What the lock file says; on a full disk nothing, and the lock holds all the same."""
    with suppress(OSError):
        os.ftruncate(file, 0)
        os.pwrite(file, holder.encode()[:_HOLDER_BYTES], 0)


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """The option `--overrides`, as often as one likes."""
    parser.add_argument("--overrides", type=Path, action="append", default=[], help="YAML file merged into params.yaml")


def read_overrides(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """What the files given as `--overrides` hold."""
    found = {path: read_yaml(path) for path in arguments.overrides}
    for path, values in found.items():
        if not isinstance(values, dict):
            raise ConfigError(f"{path}: must hold blocks as params.yaml does, such as `train:`; it holds "
                              f"{'nothing' if values is None else 'none'}.")  # fmt: skip
    return list(found.values())


def guarded(work: Callable[[], Any]) -> None:
    """Call `work`; an error that explains itself, or a Prefect server that is gone, ends the process with status 1."""
    progress.quiet_libraries()
    running.end_left_over()
    try:
        if "PREFECT_API_URL" not in os.environ:  # a flow starts a server, which makes it
            databases.private(Path(os.environ["PREFECT_HOME"]) / running.DATABASE)
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
