"""Reads and writes JSON, text, bytes and tables of results."""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simgap.formats.atomic import replacing
from simgap.types import SimgapError


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON; see `as_json`."""
    write_text(path, as_json(value) + "\n")


def as_json(value: Any) -> str:
    """A value as JSON, keys sorted; arrays as lists, and null for numbers that are not finite, which JSON lacks."""
    return json.dumps(_plain(value), indent=1, sort_keys=True, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_json(path: Path) -> Any:
    """The content of a JSON file; SimgapError where it is missing or damaged."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise no_such_file(path) from None
    except (OSError, ValueError, RecursionError) as error:
        raise SimgapError(
            f"{path}: is no whole JSON file ({error}). Delete it and run the stage that writes it."
        ) from None


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_bytes(path: Path, content: bytes, private: bool = False) -> None:
    """Write bytes as they are; `private`: readable by the owner only."""
    with replacing(path) as temporary:
        temporary.touch(0o600 if private else 0o644)
        temporary.write_bytes(content)


def read_bytes(path: Path) -> bytes:
    """A file's bytes; SimgapError where there is none."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise no_such_file(path) from None


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV, floats with 6 significant digits; a key that a row lacks is left blank."""
    header = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, header, lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: _cell(value) for key, value in row.items()} for row in rows)
    write_text(path, text.getvalue())


def _cell(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float | np.floating) else value


def no_such_file(path: Path) -> SimgapError:
    """The error for a missing file of a stage."""
    return SimgapError(f"{path}: there is no such file. Run the stage that writes it.")
