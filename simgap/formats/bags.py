"""Columns of a bag: one number per message, with its stamp."""

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from simgap import resample
from simgap.formats import bag_messages
from simgap.types import MOST_ROWS, RecordingError

_SHOWN = 200  # characters of a bag's own text in a message


class Wanted(NamedTuple):
    """Where a column comes from: a topic, a field of its messages, the angle that is taken of a quaternion, and whether
    stamps are those of the headers or the receive times."""

    topic: str
    field: str
    angle: str
    by_header: bool


def columns(path: Path, wanted: Mapping[str, Wanted]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Stamps [s] since the first, and values, of every column; RecordingError where the bag lacks one."""
    by_topic: dict[str, list[str]] = {}
    for name, column in wanted.items():
        by_topic.setdefault(column.topic, []).append(name)
    times = {name: array("d") for name in wanted}
    values = {name: array("d") for name in wanted}
    first: int | None = None
    for message in bag_messages.messages(path, by_topic.keys()):
        for name in by_topic[message.topic]:
            stamp = _stamp(message, path) if wanted[name].by_header else message.received_ns
            first = stamp if first is None else first
            times[name].append((stamp - first) * 1e-9)  # nanoseconds since 1970 do not fit a float
            values[name].append(_value(message.content, wanted[name], path))
            if len(values[name]) > MOST_ROWS:
                raise RecordingError(f"{path}: topic {message.topic} has more than {MOST_ROWS:,} messages, the most of "
                                     "a session. Split the bag.")  # fmt: skip
    return {name: (np.array(times[name]), np.array(values[name])) for name in wanted}


def _stamp(message: bag_messages.Message, path: Path) -> int:
    stamp = _member(_member(message.content, "header"), "stamp")
    seconds = _member(stamp, "sec")
    nanoseconds = next((n for n in (_member(stamp, "nanosec"), _member(stamp, "nsec")) if n is not None), None)
    if seconds is None or nanoseconds is None:
        raise RecordingError(
            f"{path}: topic {message.topic} has no stamped header. Give `time: received` for its columns."
        )
    try:
        if abs(int(seconds)) < 2**63 and abs(int(nanoseconds)) < 2**63:
            return int(seconds) * 1_000_000_000 + int(nanoseconds)
    except (TypeError, ValueError, OverflowError):
        pass
    raise RecordingError(
        f"{path}: topic {message.topic} has a header stamped {str(seconds)[:_SHOWN]} s and "
        f"{str(nanoseconds)[:_SHOWN]} ns; both must be whole numbers. Give `time: received` for its columns."
    )


def _member(content: Any, name: str) -> Any:
    """A field of a message, an entry of a list by its number, or None."""
    if isinstance(content, Mapping):
        return content.get(name)
    if name.isdecimal() and hasattr(content, "__getitem__"):
        return content[int(name)] if int(name) < len(content) else None
    return None if name.startswith("_") else getattr(content, name, None)


def _value(content: Any, wanted: Wanted, path: Path) -> float:
    value, field, where = content, wanted.field, f"{path}: topic {wanted.topic}"
    for name in field.split("."):
        inner = _member(value, name)
        if inner is None:
            raise RecordingError(f"{where} has no {field!r}: {name!r} is not in {_names(value)}. Mend it in the "
                                 "mapping file.")  # fmt: skip
        value = inner
    parts = [_member(value, axis) for axis in "xyzw"]
    try:
        if all(part is not None for part in parts):
            angles = resample.angles(*(float(part) for part in parts))
            return angles[("yaw", "pitch", "roll").index(wanted.angle)]
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise RecordingError(f"{where}: {field!r} must be a number, or a quaternion of which an angle is taken; it "
                             f"is {type(value).__name__}. Name one of its own fields.") from None  # fmt: skip


def _names(content: Any) -> str:
    """The names that may come next in a field's path."""
    if isinstance(content, Mapping):
        names = map(str, content)
    elif hasattr(content, "__getitem__"):
        return f"a list of {len(content)}"
    else:
        names = getattr(content, "__slots__", None) or getattr(content, "__dict__", ())
    return ", ".join(name for name in names if not name.startswith("_"))[:_SHOWN] or f"a {type(content).__name__}"
