"""What a set of recordings holds, and what in it looks wrong: rates, gaps, ranges, kinematics, excitation."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.types import Field, Recording, Schema

STALL = 1.5
"""Times the median interval from which on a row is a stall."""
JUMP = 12.0
"""Times the largest usual change of a row (its 99 % quantile) from which on a change is a jump."""
MOVED = 0.01
"""Share of a command's greatest size that counts as moving."""


class Rate(NamedTuple):
    """Intervals between the rows of a session [s]."""

    median_s: float
    low_s: float
    high_s: float
    stalls: float
    longest_s: float
    longest_row: int


class Column(NamedTuple):
    """What a column does over all sessions; a jump is (session, row), rows counted from 1."""

    low: float
    high: float
    std: float
    repeated: float
    jumps: tuple[tuple[str, int], ...]


class Kinematics(NamedTuple):
    """A velocity against the change of its position: slope of the one on the other and their correlation.

    Both are 1 where units, frames and stamps are right.
    """

    position: str
    slope: float
    correlation: float


class Excitation(NamedTuple):
    """What a command was made to do: share of rows in which it moves, values, band, likeness to another command."""

    moving: float
    low: float
    high: float
    changes: float
    band_hz: float
    like: str
    correlation: float


def rate(recording: Recording) -> Rate:
    """Median and 5 % to 95 % of the intervals, share of stalls, the longest and the row before it."""
    dt = np.diff(recording.time_s)
    low, median, high = np.quantile(dt, [0.05, 0.5, 0.95])
    return Rate(median, low, high, float(np.mean(dt > STALL * median)), float(dt.max()), int(dt.argmax()) + 1)


def column(recordings: Sequence[Recording], values: Sequence[Float[np.ndarray, " T"]], angle: bool) -> Column:
    """`values`: the column, session by session."""
    whole = np.concatenate(values)
    steps = [_wrapped(np.diff(v)) if angle else np.diff(v) for v in values]
    size = np.abs(np.concatenate(steps))
    usual = np.quantile(size[size > 0], 0.99) if (size > 0).any() else np.inf
    jumps = tuple((r.name, int(i) + 2) for r, s in zip(recordings, steps, strict=True)
                  for i in np.flatnonzero(np.abs(s) > JUMP * usual))  # fmt: skip
    return Column(float(whole.min()), float(whole.max()), float(whole.std()), float(np.mean(size == 0)), jumps)


def kinematics(schema: Schema, recordings: Sequence[Recording]) -> dict[str, Kinematics]:
    """By velocity of the state: how it agrees with the change of the position of the same body and axis.

    Mean of the two rows' velocities against the difference quotient, in the frame that both are given in.
    """
    found = {}
    for i, velocity in enumerate(schema.state):
        j = _position_of(schema, velocity)
        if j is None:
            continue
        moved, told = [], []
        for r in recordings:
            step = np.diff(r.state[:, j])
            moved.append((_wrapped(step) if schema.state[j].kind == "angle" else step) / np.diff(r.time_s))
            told.append((r.state[1:, i] + r.state[:-1, i]) / 2)
        x, y = np.concatenate(told), np.concatenate(moved)
        if x.std() > 0 and y.std() > 0:
            slope = float(np.cov(x, y)[0, 1] / x.var(ddof=1))
            found[velocity.name] = Kinematics(schema.state[j].name, slope, float(np.corrcoef(x, y)[0, 1]))
    return found


def excitation(schema: Schema, recordings: Sequence[Recording]) -> dict[str, Excitation]:
    """By command; `band_hz` is the frequency below which nine tenths of its power about the mean lie."""
    u = np.concatenate([r.command for r in recordings])
    spread = u.std(0)
    scaled = (u - u.mean(0)) / np.where(spread > 0, spread, 1)
    correlations = scaled.T @ scaled / len(u)
    found = {}
    for i, field in enumerate(schema.command):
        size = np.abs(u[:, i]).max()
        others = [k for k in range(u.shape[1]) if k != i and spread[k] > 0 and spread[i] > 0]
        like = max(others, key=lambda k: abs(correlations[i, k]), default=None)
        changes = np.mean(np.concatenate([np.diff(r.command[:, i]) != 0 for r in recordings]))
        found[field.name] = Excitation(
            float(np.mean(np.abs(u[:, i]) > MOVED * size)) if size else 0.0, float(u[:, i].min()), float(u[:, i].max()),
            float(changes), _band(recordings, i), schema.command[like].name if like is not None else "",
            float(correlations[i, like]) if like is not None else 0.0,
        )  # fmt: skip
    return found


def _band(recordings: Sequence[Recording], i: int) -> float:
    """Frequency [Hz] below which nine tenths of a command's power lie, in the longest session."""
    longest = max(recordings, key=lambda r: len(r.time_s))
    signal = longest.command[:, i] - longest.command[:, i].mean()
    power = np.abs(np.fft.rfft(signal)) ** 2
    if not power.sum():
        return 0.0
    frequency = np.fft.rfftfreq(len(signal), float(np.median(np.diff(longest.time_s))))
    return float(frequency[np.searchsorted(np.cumsum(power) / power.sum(), 0.9)])


def findings(
    schema: Schema,
    time_step: float,
    rates: Mapping[str, Rate],
    columns: Mapping[str, Column],
    moved: Mapping[str, Kinematics],
    excited: Mapping[str, Excitation],
) -> list[str]:
    """What looks wrong, in words, each with what to do; `time_step` [s] is the simulator's."""
    said = []
    for name, r in rates.items():
        if abs(r.median_s / time_step - 1) > 0.1:
            said.append(f"{name}: rows are {r.median_s:.4g} s apart, the simulator's step is {time_step:.4g} s. "
                        "Resample (`simgap import`), or give the simulator that step.")  # fmt: skip
        if r.stalls > 0.01:
            said.append(f"{name}: {r.stalls:.0%} of the rows last longer than {STALL:g} medians, at most "
                        f"{r.longest_s:.3g} s (row {r.longest_row}). Look for a recorder that stalls.")  # fmt: skip
    for name, c in columns.items():
        if c.low == c.high:
            said.append(f"{name} never changes from {c.low:.4g}. Nothing can be said of what depends on it.")
        elif name in {f.name for f in schema.state} and c.repeated > 0.5:
            said.append(f"{name} repeats its last value in {c.repeated:.0%} of the rows. Look for a sensor slower than "
                        "the rows, and lower the rate.")  # fmt: skip
        if c.jumps:
            where = ", ".join(f"{session} row {row}" for session, row in c.jumps[:3])
            said.append(f"{name} jumps {len(c.jumps)} times ({where}). Look for outliers, a reset, or an angle that "
                        "wraps at another place than pi.")  # fmt: skip
    for name, k in moved.items():
        if abs(k.correlation) < 0.5:
            said.append(f"{name} does not go with the change of {k.position} (correlation {k.correlation:.2f}). Look "
                        "at frames (world or body), at the topic, at the clocks.")  # fmt: skip
        elif not 0.8 < k.slope < 1.25:
            said.append(f"{k.position} changes by {k.slope:.3g} times what {name} says. Look at units, signs, "
                        "stamps and rate.")  # fmt: skip
    for name, e in excited.items():
        if e.moving == 0:
            said.append(f"The command {name} is never used: what it does cannot be learnt. Record it.")
        elif e.moving < 0.05:
            said.append(f"The command {name} moves in {e.moving:.1%} of the rows alone. Record more of it.")
        if abs(e.correlation) > 0.95 and name < e.like:
            said.append(f"The commands {name} and {e.like} go together (correlation {e.correlation:.2f}): whose effect "
                        "is whose cannot be told. Record them apart.")  # fmt: skip
    return said


def _position_of(schema: Schema, velocity: Field) -> int | None:
    if velocity.kind != "velocity" or not velocity.body:
        return None
    same = [k for k, f in enumerate(schema.state) if (f.body, f.axis, f.frame) == (velocity.body, velocity.axis,
            velocity.frame) and f.kind in ("position", "angle")]  # fmt: skip
    return same[0] if same else None


def _wrapped(angle: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    return (angle + np.pi) % (2 * np.pi) - np.pi
