"""Digests of files, and whether a stage's result is there and whole."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

from simgap.formats.arrays import load_arrays
from simgap.formats.documents import no_such_file, read_json
from simgap.types import SimgapError


def digest_of(paths: Sequence[Path]) -> str:
    """16 hexadecimal digits that identify files by content and by path below the folder they share.

    SHA-256, the same for a copy of the files elsewhere and in any order. Raises SimgapError when one is missing.
    """
    shared = os.path.commonpath([path.parent for path in paths])
    total = hashlib.sha256()
    for name, path in sorted((path.relative_to(shared).as_posix(), path) for path in paths):
        try:
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256")
        except FileNotFoundError:
            raise no_such_file(path) from None
        total.update(name.encode() + b"\0" + content.digest())
    return total.hexdigest()[:16]


def fingerprint_of(record: Path, arrays: Path) -> str | None:
    """The fingerprint that a record has, if it and the arrays that it is of are there and whole."""
    try:
        load_arrays(arrays)
        return read_json(record).get("fingerprint")
    except (SimgapError, AttributeError):
        return None
