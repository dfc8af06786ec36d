"""Velocity columns that were not measured: they are the finite difference of their position.

Such a column adds no information, its noise is that of the position once more, and it is late or early by half a row. A
model that takes it for a measurement repairs the differentiator instead of the physics.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from simgap.layout import Layout, X, Y
from simgap.survey import GAP, leading
from simgap.types import Recording, Schema

UNEXPLAINED = 0.25
"""A velocity is a difference of its position where the two differ by less than this share of the velocity's roughness.

Roughness is what of the velocity changes from row to row: its distance from the line between its neighbours, in units
such that white noise has its own standard deviation. A measurement with noise of its own differs from the difference by
at least that noise, a share of 1. The exact velocity of a motion differs from its central difference by at least
1 / sqrt(6) = 0.41 of its roughness at every frequency (v'' h^2 / 6 against v'' h^2 / sqrt(6) where it is smooth), and
from the other differences by more; one that a simulator integrates in two steps a row, v' = v + h a / 2, by 0.40.
"""
LEAST_ROWS, MOST_ROWS = 20, 50_000
"""Rows to compare, at least; and the rows of the first sessions that are enough."""
FILTER_ROWS, FILTER_MEMORY, FILTER_SHARE = 5, 2, 0.01
"""A filtered difference is a linear function of the differences of so many rows to either side, and of so many of the
filter's own last outputs, up to this share of what those outputs alone leave open."""
JAGGED = -0.6
"""Correlation of successive second changes of a difference, below which it shows the position's noise: white noise in
the position gives -3/4, an acceleration that is new in every row -1/3 to -1/2, a smooth motion nearly 1."""


class Derived(NamedTuple):
    """A velocity that is a difference of its position, of "x and y" along a body's own axis; `kind`: forward, backward,
    central, or filtered."""

    velocity: str
    position: str
    kind: str


def derived(schema: Schema, recordings: Sequence[Recording]) -> list[Derived]:
    """The velocities that are differences of the positions that they change, over the sessions together.

    Differences are forward (p[t+1] - p[t]) / h, backward (p[t] - p[t-1]) / h and central (p[t+1] - p[t-1]) / 2h, by the
    rows' own time stamps or by their median interval; angles are differenced the short way round. Of a velocity along a
    body's own axis, differences of the world's x and y are turned by the heading of its row. A filtered difference is
    looked for where the position is noisy: without noise, a measured velocity is a linear function of neighbouring
    positions too.
    """
    found, layout = [], Layout(schema)
    pieces = [piece for r in leading(recordings, MOST_ROWS) for piece in _pieces(r)]
    for motion in _motions(layout):
        kind = _kind([_Pair.of(piece, layout.angles, motion) for piece in pieces])
        if kind:
            positions = " and ".join(schema.state[p].name for p in motion.positions)
            found.append(Derived(schema.state[motion.velocity].name, positions, kind))
    return found


class _Motion(NamedTuple):
    """Columns of a velocity and of the positions that it changes: its own, or the world's x and y for a velocity along
    a body's own axis (`X` or `Y`), which the heading turns."""

    velocity: int
    positions: list[int]
    heading: int | None = None
    axis: int = X


def _motions(layout: Layout) -> Iterator[_Motion]:
    for p, v in enumerate(layout.integrates):
        if v >= 0:
            yield _Motion(int(v), [p])
    for b, heading in enumerate(layout.heading):
        x_and_y = [int(p) for p in layout.position[b, [X, Y]]]
        if heading is None or min(x_and_y) < 0 or not layout.in_world("position", b) or layout.in_world("velocity", b):
            continue
        for axis in (X, Y):
            if layout.velocity[b, axis] >= 0:
                yield _Motion(int(layout.velocity[b, axis]), x_and_y, heading, axis)


def _pieces(recording: Recording) -> list[Recording]:
    """A session cut at its gaps: across one, all differences are about the same."""
    interval = np.diff(recording.time_s)
    cuts = np.flatnonzero(interval > GAP * np.median(interval)) + 1 if len(interval) else []
    parts = (np.split(a, cuts) for a in (recording.time_s, recording.state, recording.command))
    return [Recording(recording.name, *part) for part in zip(*parts, strict=True)]


LATE: Mapping[str, str] = {"backward": "half a row late", "forward": "half a row early",
                           "central": "smoothed over two rows", "filtered": "smoothed and late"}  # fmt: skip


def sentence(found: Derived) -> str:
    """What is wrong, why, and what to do."""
    kind = {"filtered": "a filtered difference"}.get(found.kind, f"the {found.kind} difference")
    return (
        f"{found.velocity} is {kind} of {found.position}, no measurement: it is {LATE[found.kind]} and has the noise "
        "of the position, so that the diagnosis would find the differentiation instead of the physics. Record the "
        "velocity that a sensor gives. Of a simulation that moves the position by one row of its own velocity, record "
        "every few steps, or add the noise of its sensors to both columns."
    )


class _Pair(NamedTuple):
    """A velocity of a session's rows, changes of its k positions, the time of each change [s], and the direction in
    which each row's velocity is measured."""

    velocity: Float[np.ndarray, " T"]
    change: Float[np.ndarray, "T-1 k"]
    interval: Float[np.ndarray, " T-1"]
    toward: Float[np.ndarray, "T k"]

    @classmethod
    def of(cls, piece: Recording, angles: Bool[np.ndarray, " s"], motion: _Motion) -> "_Pair":
        change = np.diff(piece.state[:, motion.positions], axis=0)
        change = np.where(angles[motion.positions], (change + np.pi) % (2 * np.pi) - np.pi, change)
        toward = np.ones((len(piece.time_s), 1))
        if motion.heading is not None:
            c, s = np.cos(piece.state[:, motion.heading]), np.sin(piece.state[:, motion.heading])
            toward = np.column_stack([c, s] if motion.axis == X else [-s, c])
        return cls(piece.state[:, motion.velocity], change, np.diff(piece.time_s), toward)

    def rate(self, by_stamps: bool) -> Float[np.ndarray, "T-1 k"]:
        """Of change of the positions, by the rows' own time stamps or by their median interval."""
        return self.change / (self.interval[:, None] if by_stamps else np.median(self.interval))


def _kind(pairs: Sequence[_Pair]) -> str:
    """What difference the velocities are, or nothing."""
    pairs = [p for p in pairs if len(p.interval) > 1]
    rough = _size(np.concatenate([_roughness(p) for p in pairs])) if pairs else 0.0
    if not rough or sum(len(p.interval) for p in pairs) < LEAST_ROWS:
        return ""
    gaps = [_gaps(p) for p in pairs]
    shares = {key: _size(np.concatenate([gap[key] for gap in gaps])) / rough for key in gaps[0]}
    nearest = min(shares, key=lambda key: shares[key])
    if shares[nearest] < UNEXPLAINED:
        return nearest.split()[0]
    return "filtered" if any(_filtered(pairs, by_stamps) for by_stamps in (True, False)) else ""


def _roughness(pair: _Pair) -> Float[np.ndarray, " T-2"]:
    """How far the velocity of each row is from the line between its neighbours, over sqrt(3/2)."""
    before, after = pair.interval[:-1], pair.interval[1:]
    line = (after * pair.velocity[:-2] + before * pair.velocity[2:]) / (before + after)
    return (pair.velocity[1:-1] - line) / np.sqrt(1.5)


def _gaps(pair: _Pair) -> dict[str, Float[np.ndarray, " T-2"]]:
    """The velocity less each difference, for all rows but the first and the last."""
    before, after = pair.interval[:-1, None], pair.interval[1:, None]
    rate, nominal = pair.rate(True), pair.rate(False)
    differences = {
        "forward": rate[1:],
        "forward nominal": nominal[1:],
        "backward": rate[:-1],
        "backward nominal": nominal[:-1],
        "central": (pair.change[1:] + pair.change[:-1]) / (before + after),
        "central nominal": (nominal[1:] + nominal[:-1]) / 2,
        "central of second order": (before * rate[1:] + after * rate[:-1]) / (before + after),
    }
    return {name: pair.velocity[1:-1] - (d * pair.toward[1:-1]).sum(1) for name, d in differences.items()}


def _filtered(pairs: Sequence[_Pair], by_stamps: bool) -> bool:
    rates = [(p.rate(by_stamps) * p.toward[1:]).sum(1) for p in pairs]
    bends = [np.diff(r, 2) for r in rates]
    power, successive = sum(float(b @ b) for b in bends), sum(float(b[1:] @ b[:-1]) for b in bends)
    if not power or successive > JAGGED * power:
        return False
    parts = [_taps(p.velocity, r) for p, r in zip(pairs, rates, strict=True) if len(r) > 2 * FILTER_ROWS + 1]
    if sum(len(output) for output, _, _ in parts) < LEAST_ROWS * (2 * FILTER_ROWS + 1 + FILTER_MEMORY):
        return False
    output, about, before = (np.concatenate(part) for part in zip(*parts, strict=True))
    left = _left(np.column_stack([before, about]), output)
    return _size(left) < FILTER_SHARE * _size(_left(before, output))


def _left(inputs: Float[np.ndarray, "n k"], output: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return output - inputs @ np.linalg.lstsq(inputs, output, rcond=None)[0]


def _taps(
    velocity: Float[np.ndarray, " T"], rate: Float[np.ndarray, " T-1"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n a"], Float[np.ndarray, "n b"]]:
    """For every row with enough neighbours: its velocity, the rates about it, the velocities before it."""
    first, last = FILTER_ROWS, len(rate) - FILTER_ROWS
    about = [rate[first + k : last + k] for k in range(-FILTER_ROWS, FILTER_ROWS + 1)]
    before = [velocity[first - k : last - k] for k in range(1, FILTER_MEMORY + 1)]
    return velocity[first:last], np.column_stack(about), np.column_stack(before)


def _size(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
