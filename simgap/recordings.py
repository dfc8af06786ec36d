"""What makes a recording usable, and how sessions become rows for learning [Hoffman et al. 2025, Data Collection]."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from simgap.types import Recording, RecordingError, Schema, Transitions

HISTORY = 2
"""Past commands appended to the state: u_{t-2}, u_{t-1} [Hoffman et al. 2025, Data Collection]."""


def check_recording(schema: Schema, file: str, columns: Mapping[str, Float[np.ndarray, " T"]]) -> Recording:
    """Columns of a file as a `Recording`, or a `RecordingError` that names file, column, row and remedy.

    Rows are counted from 1, the header apart. The checks: every column of the schema is there and numeric; no value
    is missing or infinite; time increases strictly; angles lie in [-pi, pi]; the session has at least one transition
    with its command history.
    """
    missing = [c for c in schema.columns if c not in columns]
    if missing:
        raise RecordingError(
            f"{file}: column {', '.join(missing)} is missing; it must have the columns {', '.join(schema.columns)}. "
            "Rename or add the column."
        )
    data: dict[str, np.ndarray] = {}
    for name in schema.columns:
        try:
            data[name] = np.asarray(columns[name], np.float64)
        except (TypeError, ValueError) as error:
            raise RecordingError(f"{file}: column {name} must hold numbers ({error}). Remove the text.") from None
        bad = np.flatnonzero(~np.isfinite(data[name]))
        if bad.size:
            raise RecordingError(
                f"{file}: column {name}, row {bad[0] + 1} is {data[name][bad[0]]}; every value must be a finite number "
                f"({bad.size} such rows). Cut the session there, or fill the gap before recording it as measured."
            )
    n_rows, least = len(data["time_s"]), HISTORY + 2
    if n_rows < least:
        raise RecordingError(
            f"{file}: the session has {n_rows} rows; at least {least} are needed for one transition with the "
            f"{HISTORY} previous commands. Leave the file out."
        )
    backwards = np.flatnonzero(np.diff(data["time_s"]) <= 0)
    if backwards.size:
        row = backwards[0] + 1
        before, after = data["time_s"][row - 1], data["time_s"][row]
        raise RecordingError(
            f"{file}: column time_s, row {row + 1} is {after} after {before}; time must increase strictly. "
            "Sort the rows, or split the file where the clock was reset."
        )
    for field in schema.state:
        if field.kind == "angle":
            outside = np.flatnonzero(np.abs(data[field.name]) > np.pi + 1e-6)
            if outside.size:
                row = outside[0]
                raise RecordingError(
                    f"{file}: column {field.name}, row {row + 1} is {data[field.name][row]}; an angle must lie in "
                    "(-pi, pi] rad. Convert degrees to radians, or wrap the angle."
                )
    stack = lambda fields: np.stack([data[f.name] for f in fields], axis=1)  # noqa: E731
    return Recording(file, data["time_s"], stack(schema.state), stack(schema.command))


def encode_state(schema: Schema, state: Float[Array, " s"]) -> Float[Array, " e"]:
    """Every angle replaced by (sin, cos): no jump at pi [Hoffman et al. 2025, Data Collection]."""
    parts: list[Array] = []
    for i, field in enumerate(schema.state):
        parts += [jnp.sin(state[i]), jnp.cos(state[i])] if field.kind == "angle" else [state[i]]
    return jnp.stack(parts)


def decode_state(schema: Schema, encoded: Float[Array, " e"]) -> Float[Array, " s"]:
    """Inverse of `encode_state`; (sin, cos) need not lie on the unit circle."""
    parts, j = [], 0
    for field in schema.state:
        if field.kind == "angle":
            parts.append(jnp.arctan2(encoded[j], encoded[j + 1]))
            j += 2
        else:
            parts.append(encoded[j])
            j += 1
    return jnp.stack(parts)


def to_transitions(schema: Schema, recordings: Sequence[Recording]) -> Transitions:
    """All transitions of the sessions; none crosses from one session into another.

    Row t of a session gives x = [encoded s_t, u_{t-2}, u_{t-1}, u_t] and y = encoded s_{t+1} - encoded s_t; the first
    two rows have no full history and the last row no successor.
    """
    encode = jax.vmap(lambda s: encode_state(schema, s))
    xs, ys, sessions = [], [], []
    for i, recording in enumerate(recordings):
        state = np.asarray(encode(jnp.asarray(recording.state)))
        u = np.asarray(recording.command, np.float32)
        last = len(u) - 1
        commands = [u[HISTORY - k : last - k] for k in range(HISTORY, -1, -1)]
        xs.append(np.concatenate([state[HISTORY:last], *commands], axis=1))
        ys.append(state[HISTORY + 1 :] - state[HISTORY:last])
        sessions.append(np.full(last - HISTORY, i, np.int32))
    return Transitions(*(jnp.asarray(np.concatenate(a)) for a in (xs, ys, sessions)))


def part(recording: Recording, first: int, last: int) -> Recording:
    """The rows from `first` to before `last`; a part of a session is named by its rows, counted from 1."""
    rows = slice(first, last)
    whole = first == 0 and last == len(recording.time_s)
    name = recording.name if whole else f"{recording.name} (rows {first + 1} to {last})"
    return Recording(name, recording.time_s[rows], recording.state[rows], recording.command[rows])


def divide(recordings: Sequence[Recording], count: int) -> tuple[list[Recording], list[Recording]]:
    """The first `count` transitions, session after session, and the rest; the session where they meet is cut in two.

    Transitions as `to_transitions` counts them, which are those of whole sessions: rows that the cut leaves with none
    are dropped, and what follows it has no history across it.
    """
    first, rest = [], []
    for recording in recordings:
        rows = len(recording.time_s)
        taken = min(max(count, 0), rows - 1 - HISTORY)
        edge = taken + 1 + HISTORY if taken else 0
        count -= taken
        if taken:
            first.append(part(recording, 0, edge))
        if rows - edge > 1 + HISTORY:
            rest.append(part(recording, edge, rows))
    return first, rest


def draw(key: PRNGKeyArray, count: int, available: int) -> Int[Array, " count"]:
    """Indices of `count` transitions drawn i.i.d. without repetition from those available."""
    return jax.random.permutation(key, available)[:count]


class Normalisation(NamedTuple):
    """Mean and standard deviation of inputs and outputs over the N training transitions."""

    x_mean: Float[Array, " x"]
    x_std: Float[Array, " x"]
    y_mean: Float[Array, " y"]
    y_std: Float[Array, " y"]


def normalisation(x: Float[Array, "N x"], y: Float[Array, "N y"]) -> Normalisation:
    """Statistics of the data at hand; a column that never changes gets unit scale."""
    scale = lambda a: jnp.where(a.std(0) > 1e-6, a.std(0), 1.0)  # noqa: E731
    return Normalisation(x.mean(0), scale(x), y.mean(0), scale(y))


def normalise(
    stats: Normalisation, x: Float[Array, "N x"], y: Float[Array, "N y"]
) -> tuple[Float[Array, "N x"], Float[Array, "N y"]]:
    """Inputs and outputs less their mean, in units of their standard deviation."""
    return (x - stats.x_mean) / stats.x_std, (y - stats.y_mean) / stats.y_std


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Sessions to fit, and held-out sessions: every fourth, or the last of fewer; of a single one its last quarter."""
    if len(recordings) == 1:
        (r,) = recordings
        edge = 3 * len(r.time_s) // 4
        part = lambda name, rows: Recording(name, r.time_s[rows], r.state[rows], r.command[rows])  # noqa: E731
        return [part(r.name, slice(0, edge))], [part(f"{r.name} (last quarter)", slice(edge, None))]
    held = set(range(3, len(recordings), 4)) or {len(recordings) - 1}
    return [r for i, r in enumerate(recordings) if i not in held], [r for i, r in enumerate(recordings) if i in held]
