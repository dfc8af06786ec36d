"""Streams of measurements, each with stamps of its own, as the evenly spaced rows of a recording."""

from collections.abc import Mapping, Sequence, Set
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.types import MOST_ROWS, ConfigError, Field, RecordingError, Schema

UNITS: Mapping[str, Mapping[str, float]] = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "rad": {"rad": 1.0, "deg": np.pi / 180},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180, "rpm": 2 * np.pi / 60},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
}
"""By the unit of a schema: what a value in another unit is multiplied by."""


class Stream(NamedTuple):
    """One column as it was recorded: its stamps [s] and its values, in the schema's unit."""

    time_s: Float[np.ndarray, " k"]
    values: Float[np.ndarray, " k"]


def factor(unit: str, wanted: str) -> float:
    """What a value in `unit` is multiplied by to be in the unit `wanted`; ConfigError where it cannot be."""
    if unit == wanted:
        return 1.0
    known = UNITS.get(wanted, {})
    if unit not in known:
        raise ConfigError(f"{unit!r} cannot be converted to {wanted}; known are {', '.join(known) or wanted}.")
    return known[unit]


def angles(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Yaw, pitch and roll of a unit quaternion [rad]: about z, then about the new y, then about the newest x."""
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return float(yaw), float(pitch), float(roll)


def align(
    schema: Schema, streams: Mapping[str, Stream], rate_hz: float, longest_gap_s: float
) -> list[dict[str, Float[np.ndarray, " T"]]]:
    """Evenly spaced rows, `time_s` and a column per stream; a new piece begins after every gap of the state's.

    States are interpolated (angles the short way round). A command is the last one that was sent by then; before the
    first one there are no rows. Raises RecordingError where the streams have no time in common, and, before any row is
    made, where there would be more than `MOST_ROWS`.
    """
    states = {field.name: streams[field.name] for field in schema.state}
    start = max(s.time_s[0] for s in streams.values())
    end = min(s.time_s[-1] for s in states.values())
    if end <= start:
        late = max(streams, key=lambda name: streams[name].time_s[0])
        early = min(states, key=lambda name: states[name].time_s[-1])
        raise RecordingError(
            f"the columns have no time in common: {late} begins at {start:.3f} s and {early} ends at {end:.3f} s. "
            "Leave the session out, or look for clocks that differ."
        )
    angles = {field.name for field in schema.state if field.kind == "angle"}
    parts = _whole(list(states.values()), start, end, longest_gap_s)
    _refuse_many(states, parts, rate_hz)
    pieces = []
    for first, last in parts:
        time = first + np.arange(int((last - first) * rate_hz + 1e-9) + 1) / rate_hz
        rows = {"time_s": time - time[0]}
        for name, stream in streams.items():
            rows[name] = _interpolated(stream, time, name in angles) if name in states else _held(stream, time)
        pieces.append(rows)
    return pieces


def _refuse_many(states: Mapping[str, Stream], parts: Sequence[tuple[float, float]], rate_hz: float) -> None:
    rows = sum((last - first) * rate_hz + 1 for first, last in parts)
    if rows <= MOST_ROWS:
        return
    whole = f"{rate_hz:g} Hz would make {rows:,.0f} rows; a session has at most {MOST_ROWS:,}."
    name = max(states, key=lambda n: np.diff(states[n].time_s).max(initial=0.0))
    pauses = np.diff(states[name].time_s)
    row = int(pauses.argmax())
    if pauses[row] * rate_hz < rows / 2:
        raise RecordingError(f"{whole} Lower rate_hz, or split the session.")
    raise RecordingError(
        f"{whole} Column {name}: value {row + 2} has the time stamp {states[name].time_s[row + 1]:g} s, after "
        f"{states[name].time_s[row]:g} s. Mend or remove it, or give a longest_gap_s below the pause."
    )


def _whole(streams: Sequence[Stream], start: float, end: float, longest: float) -> list[tuple[float, float]]:
    """The parts of [start, end] in which no stream pauses for longer than `longest` [s]."""
    gaps = sorted(
        (float(s.time_s[i]), float(s.time_s[i + 1]))
        for s in streams
        for i in np.flatnonzero(np.diff(s.time_s) > longest)
    )
    parts, since = [], start
    for begin, after in gaps:
        if begin > since:
            parts.append((since, min(begin, end)))
        since = max(since, after)
    return [(a, b) for a, b in [*parts, (since, end)] if b > a]


def _interpolated(stream: Stream, time: Float[np.ndarray, " T"], angle: bool) -> Float[np.ndarray, " T"]:
    if not angle:
        return np.interp(time, stream.time_s, stream.values)
    turned = np.interp(time, stream.time_s, np.unwrap(stream.values))
    return (turned + np.pi) % (2 * np.pi) - np.pi


def _held(stream: Stream, time: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    # A stamp that equals a row's but for rounding was sent by then.
    return stream.values[np.searchsorted(stream.time_s, time + 1e-9, side="right") - 1]


def to_world(
    schema: Schema, columns: Mapping[str, Float[np.ndarray, " T"]], body: Set[str]
) -> dict[str, Float[np.ndarray, " T"]]:
    """Columns of the state named in `body`, given along the axes of the turning body, along the world's.

    A velocity is turned by the yaw of its body, or of the body that carries it; a position is that of a carried body as
    seen from its carrier, and is moved with it too. Raises ConfigError where there is no such yaw, or where one of the
    pair x and y is in another frame than the other.
    """
    found = dict(columns)
    fields = {(f.body, f.kind, f.axis): f for f in schema.state}
    for name in sorted(body):
        field = next(f for f in schema.state if f.name == name)
        if field.frame != "world" or field.axis not in ("x", "y"):
            continue
        other = fields.get((field.body, field.kind, "y" if field.axis == "x" else "x"))
        if other is None or other.name not in body:
            raise ConfigError(f"column {name}: x and y must be in the same frame; {other.name if other else 'none'} is "
                              "not. Give frame: body for both, or for neither.")  # fmt: skip
        if field.axis == "x":
            carrier = _carrier(schema, field)
            turn = columns[fields[carrier, "angle", "yaw"].name]
            x, y = columns[name], columns[other.name]
            found[name], found[other.name] = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
            if field.kind == "position":
                for mine in (field, other):
                    found[mine.name] = found[mine.name] + columns[fields[carrier, "position", mine.axis].name]
    return found


def _carrier(schema: Schema, field: Field) -> str:
    """The body whose yaw a column's axes turn with: the field's own, or the one that carries it."""
    turning = {f.body for f in schema.state if f.kind == "angle" and f.axis == "yaw"}
    carrier = dict(schema.mounts).get(field.body, field.body)
    own = field.body if field.kind != "position" and field.body in turning else carrier
    if own not in turning or (field.kind == "position" and own == field.body):
        raise ConfigError(f"column {field.name}: it cannot be in a body's frame, no yaw of another body carries it. "
                          "Give it in the world's frame.")  # fmt: skip
    return own
