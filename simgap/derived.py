"""Velocity columns that were not measured: they are the finite difference of their position.

Such a column adds no information, its noise is that of the position once more, and it is late or early by half a row. A
model that takes it for a measurement repairs the differentiator instead of the physics.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.layout import Layout
from simgap.survey import leading
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
    """A velocity that is a difference of its position; `kind`: forward, backward, central, or filtered."""

    velocity: str
    position: str
    kind: str


def derived(schema: Schema, recordings: Sequence[Recording]) -> list[Derived]:
    """The velocities that are differences of the positions that they change, over the sessions together.

    Differences are forward (p[t+1] - p[t]) / h, backward (p[t] - p[t-1]) / h and central (p[t+1] - p[t-1]) / 2h, by the
    rows' own time stamps or by their median interval; angles are differenced the short way round. A filtered
    difference is looked for where the position is noisy: without noise, a measured velocity is a linear function of
    neighbouring positions too.
    """
    found = []
    for p, v in enumerate(Layout(schema).integrates):
        if v < 0:
            continue
        angle = schema.state[p].kind == "angle"
        kind = _kind([_Pair.of(r, p, int(v), angle) for r in leading(recordings, MOST_ROWS)])
        if kind:
            found.append(Derived(schema.state[int(v)].name, schema.state[p].name, kind))
    return found


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
    """A session's velocity v, changes of position, and the time of each change [s]."""

    velocity: Float[np.ndarray, " T"]
    change: Float[np.ndarray, " T-1"]
    interval: Float[np.ndarray, " T-1"]

    @classmethod
    def of(cls, recording: Recording, position: int, velocity: int, angle: bool) -> "_Pair":
        change = np.diff(recording.state[:, position])
        if angle:
            change = (change + np.pi) % (2 * np.pi) - np.pi
        return cls(recording.state[:, velocity], change, np.diff(recording.time_s))


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
    v, before, after = pair.velocity[1:-1], pair.interval[:-1], pair.interval[1:]
    rate, nominal = _rate(pair, True), _rate(pair, False)
    return {
        "forward": v - rate[1:],
        "forward nominal": v - nominal[1:],
        "backward": v - rate[:-1],
        "backward nominal": v - nominal[:-1],
        "central": v - (pair.change[1:] + pair.change[:-1]) / (before + after),
        "central nominal": v - (nominal[1:] + nominal[:-1]) / 2,
        "central of second order": v - (before * rate[1:] + after * rate[:-1]) / (before + after),
    }


def _rate(pair: _Pair, by_stamps: bool) -> Float[np.ndarray, " T-1"]:
    return pair.change / (pair.interval if by_stamps else np.median(pair.interval))


def _filtered(pairs: Sequence[_Pair], by_stamps: bool) -> bool:
    rates = [_rate(p, by_stamps) for p in pairs]
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
