"""Lock files: a folder belongs to one command at a time."""

import fcntl
import os
import shlex
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from simgap.formats.atomic import remove_unfinished
from simgap.formats.folders import make_folder
from simgap.types import SimgapError

_HOLDER_BYTES = 4096


@contextmanager
def alone(root: Path) -> Iterator[None]:
    """Hold a folder, and clear it of what a killed run was writing; SimgapError where another process works there."""
    with held(root / ".lock"):
        remove_unfinished(root)
        yield


@contextmanager
def held(lock: Path) -> Iterator[None]:
    """Hold a lock file, which says by whom, as long as the block runs and the process lives.

    Raises SimgapError that names the holder where there is one: it would lose what it is writing.
    """
    make_folder(lock.parent)
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
