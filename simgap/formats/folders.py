"""Makes folders, keeps files private, and deletes files and folders, but only those that lie in a given folder."""

import os
import shutil
import sys
from contextlib import suppress
from pathlib import Path

from simgap.types import SimgapError


def make_folder(folder: Path) -> None:
    """Make a folder if it is missing; SimgapError where it cannot be made or written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError("it is not writable")
    except OSError as error:
        raise SimgapError(
            f"{folder}: must be a folder that can be written to ({error}). Give another one, or mend its permissions."
        ) from None


def keep_private(path: Path) -> None:
    """Create an empty database if there is none, and make it and SQLite's files next to it readable by the owner only.
    SimgapError where its folder cannot be written to.

    SQLite gives the files that it adds later the rights of the database. An existing database is not opened: closing it
    would release the locks that this process holds on it.
    """
    make_folder(path.parent)
    with suppress(OSError):  # another user's database, or a read-only disk: who opens it next says so
        if not path.exists():
            os.close(os.open(path, os.O_CREAT | os.O_EXCL, 0o600))
        for file in (path, *path.parent.glob(f"{path.name}-*")):
            file.chmod(0o600)


def remove_folder(folder: Path, within: Path) -> None:
    """Delete a folder and its content, if it exists; of links in it, only the links.

    Raises SimgapError, and deletes nothing, where it does not lie in the folder `within` once links are followed.
    Raises SimgapError that names the part and the reason where a part of it cannot be deleted.
    """
    if not os.path.lexists(folder):
        return
    _refuse_outside(folder.resolve(), folder, within)
    failed: list[tuple[str, BaseException]] = []
    if sys.version_info >= (3, 12):
        shutil.rmtree(folder, onexc=lambda _, path, error: failed.append((path, error)))
    else:
        shutil.rmtree(folder, onerror=lambda _, path, error: failed.append((path, error[1])))
    if failed:
        (path, error), others = failed[0], len(failed) - 1
        raise SimgapError(
            f"{folder}: {path} cannot be deleted ({getattr(error, 'strerror', None) or error})"
            f"{f', nor {others} others' if others else ''}. Fix the permissions of the folder that it lies in, or end "
            "the program that uses it, and start again."
        )


def remove_file(path: Path, within: Path) -> None:
    """Delete a file, if it exists; of a link, only the link. Raises SimgapError as `remove_folder` does."""
    if not os.path.lexists(path):
        return
    _refuse_outside(path.parent.resolve() / path.name, path, within)
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise SimgapError(
            f"{path}: cannot be deleted ({error.strerror or error}). Fix the permissions of the folder that it lies "
            "in, and start again."
        ) from None


def _refuse_outside(place: Path, path: Path, within: Path) -> None:
    """SimgapError unless `place`, where `path` leads, lies below the folder `within`."""
    if within.resolve() not in place.parents:
        raise SimgapError(
            f"{path}: leads to {place}, which does not lie in {within.resolve()}. Only what lies in there is deleted; "
            "nothing was. Replace the link by a folder, or give another name."
        )
