"""What a set of recordings holds: rates, gaps, ranges, kinematics, excitation. What of it looks wrong: `findings`."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.types import Field, Recording, Schema

STALL = 1.5
"""Times the median interval from which on a row is a stall."""
GAP, MOST_GAPS = 10.0, 5
"""Times the median interval, and all that are shorter, from which on an interval is a gap; where there are more such
intervals, they are stalls."""
JUMP = 12.0
"""Times the largest usual change of a row (its 99 % quantile) from which on a change is a jump."""
MOVED = 0.01
"""Share of a command's greatest size that counts as moving."""
ALIKE, OFF = 0.9, 1.5
"""From this correlation on, a velocity has the form of its position's rate of change; a factor beyond this between the
two is then one of units or signs, and not a sensor that is badly calibrated."""


class Rate(NamedTuple):
    """Intervals between the rows of a session [s].

    gaps: how many of the longest are by far longer than all others; `others_s`: the longest of these.
    """

    median_s: float
    low_s: float
    high_s: float
    stalls: float
    longest_s: float
    longest_row: int
    gaps: int
    others_s: float


class Column(NamedTuple):
    """What a column does over all sessions; a jump is (session, row), rows counted from 1; `still`: the sessions in
    which it never changes."""

    low: float
    high: float
    std: float
    repeated: float
    jumps: tuple[tuple[str, int], ...]
    still: tuple[str, ...]


class Kinematics(NamedTuple):
    """A velocity against the change of its position: slope of the one on the other and their correlation about zero.

    Both are 1 where units, frames and stamps are right. Where one is zero the other is: no mean is taken out.
    """

    position: str
    slope: float
    correlation: float

    @property
    def in_other_units(self) -> bool:
        """Whether the two differ by their units or signs, so that a diagnosis would find these and not the physics."""
        return abs(self.correlation) > ALIKE and not 1 / OFF < self.slope < OFF


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
    falling = np.sort(dt)[::-1]
    others = np.maximum(np.append(falling[1:], 0.0), median)
    apart = np.flatnonzero(falling[:MOST_GAPS] > GAP * others[:MOST_GAPS])
    gaps = int(apart[-1]) + 1 if len(apart) else 0
    return Rate(median, low, high, float(np.mean(dt > STALL * median)), float(falling[0]), int(dt.argmax()) + 1, gaps,
                float(others[max(gaps - 1, 0)]))  # fmt: skip


def leading(recordings: Sequence[Recording], rows: int) -> list[Recording]:
    """The first sessions that have so many rows together, or all."""
    ends = np.cumsum([len(r.time_s) for r in recordings])
    return list(recordings[: int(np.searchsorted(ends, rows)) + 1])


def column(recordings: Sequence[Recording], values: Sequence[Float[np.ndarray, " T"]], angle: bool) -> Column:
    """`values`: the column, session by session."""
    whole = np.concatenate(values)
    steps = [_wrapped(np.diff(v)) if angle else np.diff(v) for v in values]
    size = np.abs(np.concatenate(steps))
    usual = np.quantile(size[size > 0], 0.99) if (size > 0).any() else np.inf
    jumps = tuple((r.name, int(i) + 2) for r, s in zip(recordings, steps, strict=True)
                  for i in np.flatnonzero(np.abs(s) > JUMP * usual))  # fmt: skip
    still = tuple(r.name for r, s in zip(recordings, steps, strict=True) if not s.any())
    return Column(float(whole.min()), float(whole.max()), float(whole.std()), float(np.mean(size == 0)), jumps, still)


def kinematics(schema: Schema, recordings: Sequence[Recording]) -> dict[str, Kinematics]:
    """By velocity of the state: how it agrees with the change of the position of the same body and axis.

    Mean of the two rows' velocities against the difference quotient, in the frame that both are given in.
    """
    found = {}
    for i, velocity in enumerate(schema.state):
        j = _position_of(schema, velocity)
        if j is None:
            continue
        moved, reported = [], []
        for r in recordings:
            step = np.diff(r.state[:, j])
            moved.append((_wrapped(step) if schema.state[j].kind == "angle" else step) / np.diff(r.time_s))
            reported.append((r.state[1:, i] + r.state[:-1, i]) / 2)
        x, y = np.concatenate(reported), np.concatenate(moved)
        if np.ptp(x) and np.ptp(y):
            correlation = float(x @ y / np.sqrt((x @ x) * (y @ y)))
            found[velocity.name] = Kinematics(schema.state[j].name, float(x @ y / (x @ x)), correlation)
    return found


def sentence(velocity: str, found: Kinematics) -> str:
    """How a velocity differs from the rate of its position, and what to do."""
    remedy = (
        "One of the two has other units or another sign, which a diagnosis would find instead of the physics. Give "
        "`unit` or `sign` in the mapping (`simgap import`)."
        if found.in_other_units
        else "Check units, signs, time stamps and rate."
    )
    return (
        f"{found.position} changes {found.slope:.3g} times as fast as {velocity} says (correlation "
        f"{found.correlation:.2f}). {remedy}"
    )


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


def _position_of(schema: Schema, velocity: Field) -> int | None:
    if velocity.kind != "velocity" or not velocity.body:
        return None
    same = [k for k, f in enumerate(schema.state) if (f.body, f.axis, f.frame) == (velocity.body, velocity.axis,
            velocity.frame) and f.kind in ("position", "angle")]  # fmt: skip
    return same[0] if same else None


def _wrapped(angle: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    return (angle + np.pi) % (2 * np.pi) - np.pi
