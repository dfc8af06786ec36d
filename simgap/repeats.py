"""Sessions that are there twice, in whole or in part."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int, UInt64

from simgap.types import Recording

RUN, FEWEST = 10, 5
"""Sessions are compared by runs of `RUN` successive rows that all differ: sensors that flicker between a few values at
rest do not repeat so many by chance. A session with `FEWEST` to `RUN` such rows is compared as a whole."""
LEAST_SHARE = 0.05
"""Share of the shorter session from which on rows in common are reported."""


class Repeat(NamedTuple):
    """Two sessions that have `rows` rows in common, of the `of` rows of the shorter one that can be compared."""

    first: str
    second: str
    rows: int
    of: int


def repeats(recordings: Sequence[Recording]) -> list[Repeat]:
    """Pairs of sessions with the same rows, whatever their time stamps; of a session that is there n times, n - 1."""
    runs = [np.unique(_runs(r)) for r in recordings]
    keys = np.concatenate(runs)
    owner = np.repeat(np.arange(len(recordings)), [len(k) for k in runs])
    order = np.lexsort((owner, keys))
    keys, owner = keys[order], owner[order]
    same = (keys[1:] == keys[:-1]) & (owner[1:] != owner[:-1])
    found = []
    for (i, j), count in Counter(zip(owner[:-1][same].tolist(), owner[1:][same].tolist(), strict=True)).items():
        first, second = sorted((i, j))
        of = min(len(runs[i]), len(runs[j]))
        if count >= LEAST_SHARE * of:
            found.append(Repeat(recordings[first].name, recordings[second].name, count + RUN - 1, of + RUN - 1))
    return sorted(found, key=lambda r: -r.rows / r.of)


def _runs(recording: Recording) -> UInt64[np.ndarray, " n"]:
    """A number for every `RUN` successive rows that differ from each other. Rows that only repeat the one before them,
    as of sensors slower than the recorder, are left out."""
    rows = _digest(np.hstack([recording.state, recording.command]))
    rows = rows[np.append(True, rows[1:] != rows[:-1])]
    run = min(RUN, len(rows))
    if run < FEWEST:
        return np.zeros(0, np.uint64)
    windows = np.lib.stride_tricks.sliding_window_view(rows, run)
    earlier = np.lib.stride_tricks.sliding_window_view(_previous(rows), run).max(axis=1)
    return _mixed(windows)[earlier < np.arange(len(windows))]


def _digest(values: np.ndarray) -> UInt64[np.ndarray, " T"]:
    return _mixed(np.ascontiguousarray(values + 0.0, np.float64).view(np.uint64))  # + 0.0: one zero, not two


def _mixed(numbers: UInt64[np.ndarray, "n k"]) -> UInt64[np.ndarray, " n"]:
    """A hash of every row."""
    mixed = np.zeros(len(numbers), np.uint64)
    for column in numbers.T:  # the finaliser of MurmurHash3, column after column
        mixed = (mixed ^ column) * np.uint64(0xFF51AFD7ED558CCD)
        mixed ^= mixed >> np.uint64(33)
        mixed *= np.uint64(0xC4CEB9FE1A85EC53)
        mixed ^= mixed >> np.uint64(33)
    return mixed


def _previous(rows: UInt64[np.ndarray, " T"]) -> Int[np.ndarray, " T"]:
    """For every row the index of the last one before it that is the same, -1 where there is none."""
    order = np.argsort(rows, kind="stable")
    found = np.full(len(rows), -1)
    same = rows[order[1:]] == rows[order[:-1]]
    found[order[1:][same]] = order[:-1][same]
    return found
