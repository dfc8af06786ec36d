"""Writes files and folders next to their place, and moves them there when they are complete."""

import hashlib
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

import psutil

from simgap.formats.folders import make_folder, remove_file, remove_folder
from simgap.types import SimgapError

_OWNER = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]
"""Prefix of the names of files that are being written: on a shared disk, other machines write too."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path next to `path` to write to. It replaces `path` if all went well, and is deleted otherwise.

    Raises SimgapError where it cannot be written, as on a full disk.
    """
    temporary = _temporary(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise SimgapError(
            f"{path}: cannot be written ({error.strerror or error}). Free disk space or fix the folder's permissions, "
            "and start again: finished work is not repeated."
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextmanager
def replacing_folder(folder: Path) -> Iterator[Path]:
    """A new folder next to `folder` to write to. It replaces `folder` if all went well, and is deleted otherwise."""
    new, old = _temporary(folder), _temporary(folder)
    try:
        make_folder(new)
        yield new
        if folder.exists():
            os.replace(folder, old)
        os.replace(new, folder)
    finally:
        remove_folder(new, folder.parent)
        remove_folder(old, folder.parent)


def remove_unfinished(folder: Path) -> None:
    """Delete the unfinished files in a folder that killed processes of this machine left."""
    for path in list(folder.rglob(f".{_OWNER}-*.tmp")):
        if not psutil.pid_exists(int(path.name.split("-")[1])):
            (remove_folder if path.is_dir() else remove_file)(path, folder)


def _temporary(path: Path) -> Path:
    return path.with_name(f".{_OWNER}-{os.getpid()}-{uuid4().hex}.tmp")
