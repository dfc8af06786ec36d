"""Where the mismatch is: outputs, regimes and times, each with its share of the excess error.

Excess is the gain in log-likelihood of a better model (the simulator with the effects found, or the black box) over the
refitted simulator, per row and output [nats].
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import MOST_ROWS, STANDS_OUT
from simgap.diagnosis.hypotheses.features import of_rows
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.diagnosis.likelihood.student_t import fit_noise, log_density
from simgap.effects.augmented import Augmented
from simgap.effects.regime import Regime, features, words
from simgap.layout import Layout
from simgap.types import Recording

SMOOTH = 15
"""Rows over which excess is averaged for the figure over time."""


class Excess(NamedTuple):
    """Excess of every scored row and output [nats], and the row's session, index and features of the motion.

    share: reduction of every output's mean square error, clipped at quantiles.
    """

    nats: Float[np.ndarray, "n s"]
    share: Float[np.ndarray, " s"]
    session: np.ndarray
    row: np.ndarray
    features: Float[np.ndarray, "n f"]
    names: list[str]
    units: list[str]


def excess(augmented: Augmented, chunks: Chunks, base: Float[np.ndarray, "C t s"], better: np.ndarray) -> Excess:
    """Compare two sets of innovations [C, t, s], in the outputs' own units."""
    counts = np.asarray(chunks.counts)
    a, b = np.asarray(base)[counts], np.asarray(better)[counts]
    nats = log_density(b, fit_noise(b)) - log_density(a, fit_noise(a))
    clipped = [np.clip(e, *(np.quantile(a, q, axis=0) for q in (0.005, 0.995))) for e in (a, b)]
    power = [(e**2).mean(0) for e in clipped]
    t = np.broadcast_to(np.arange(counts.shape[1]), counts.shape)
    row = (np.asarray(chunks.row)[:, None] + t)[counts]
    session = np.broadcast_to(np.asarray(chunks.session)[:, None], counts.shape)[counts]
    names, units = map(list, zip(*((f.name, f.unit) for f in features(augmented.layout)), strict=True))
    values = of_rows(augmented.layout, chunks)
    return Excess(nats, np.clip(1 - power[1] / np.maximum(power[0], 1e-18), 0, 1), session, row, values, names, units)


def outputs(augmented: Augmented, found: Excess) -> list[dict]:
    """Outputs whose error the better model reduces, with the share removed, largest first."""
    names = [f.name for f in augmented.simulator.schema.outputs]
    total = found.nats.sum(0)
    keep = [i for i in range(len(names)) if total[i] > 0.02 * np.maximum(total, 0).sum() and found.share[i] > 0.005]
    return [{"name": names[i], "excess": float(found.share[i])} for i in sorted(keep, key=lambda i: -found.share[i])]


def regimes(found: Excess) -> list[dict]:
    """Up to three one-sided rules, each on another feature, that hold most of the excess in few rows."""
    per_row = found.nats.sum(1)
    total = per_row.sum()
    best: dict[str, tuple[float, dict]] = {}
    if total <= 0:
        return []
    for k, name in enumerate(found.names):
        values = found.features[:, k]
        for q in np.linspace(0.05, 0.95, 19):
            edge = float(np.quantile(values, q))
            for sign, inside in ((">", values > edge), ("<", values < edge)):
                rows = float(inside.mean())
                share = float(per_row[inside].sum() / total)
                lead = min(share, 1.0) - rows
                if 0 < rows <= MOST_ROWS and lead > STANDS_OUT and lead > best.get(name, (0.0, {}))[0]:
                    rule = f"{name} {sign} {edge:.2g} {found.units[k]}"
                    best[name] = (lead, {"regime": rule, "share": min(share, 1.0), "rows": rows})
    return [rule for _, rule in sorted(best.values(), key=lambda v: -v[0])[:3]]


def share(found: Excess, layout: Layout, regime: Regime) -> dict:
    """A regime with its share of the excess and of the rows, in the layout of `regimes`."""
    per_row = found.nats.sum(1)
    rows = regime.side * (found.features[:, regime.feature] - regime.edge) > 0
    part = float(per_row[rows].sum() / per_row.sum())
    return {"regime": words(layout, regime), "share": min(max(part, 0.0), 1.0), "rows": float(rows.mean())}


def intervals(found: Excess, recordings: Sequence[Recording]) -> list[dict]:
    """The window with most of the excess, if it is concentrated in one of several sessions."""
    per_row = found.nats.sum(1)
    total = per_row.sum()
    reported = []
    if total <= 0 or len(recordings) < 2:
        return reported
    for s, r in enumerate(recordings):
        mine = np.flatnonzero(found.session == s)
        share, rows = per_row[mine].sum() / total, len(mine) / len(per_row)
        if len(mine) and share > 0.6 and share > 2.5 * rows:
            start, stop = _window(per_row[mine])
            times = r.time_s[np.minimum(found.row[mine], len(r.time_s) - 1)]
            reported.append({"session": r.name, "from_s": float(times[start]), "to_s": float(times[stop]),
                         "share": float(min(per_row[mine[start : stop + 1]].sum() / total, 1.0))})  # fmt: skip
    return reported


def _window(values: np.ndarray) -> tuple[int, int]:
    """First and last index of the window with the largest sum above half of the mean (Kadane's algorithm)."""
    level = values - max(values.mean(), 0.0) * 0.5
    best, start, current, begin = (-np.inf, 0, 0), 0, 0.0, 0
    for i, v in enumerate(level):
        if current <= 0:
            current, begin = 0.0, i
        current += v
        if current > best[0]:
            best = (current, begin, i)
    del start
    return best[1], best[2]


def heat(augmented: Augmented, found: Excess) -> dict:
    """Mean excess [nats a row] of each output in the low, middle and high third of every feature of the motion."""
    chosen = [k for k, name in enumerate(found.names) if not name.startswith("|") and "cmd" not in name]
    chosen = chosen or list(range(len(found.names)))
    labels, columns = [], []
    for k in chosen:
        values = found.features[:, k]
        edges = np.quantile(values, [1 / 3, 2 / 3])
        for word, inside in (("low", values <= edges[0]), ("middle", (values > edges[0]) & (values <= edges[1])),
                             ("high", values > edges[1])):  # fmt: skip
            labels.append(f"{found.names[k]}: {word}")
            columns.append(found.nats[inside].mean(0) if inside.any() else np.full(found.nats.shape[1], np.nan))
    names = [f.name for f in augmented.simulator.schema.outputs]
    return {"outputs": names, "regimes": labels, "values": np.stack(columns, axis=1)}


def strips(found: Excess, recordings: Sequence[Recording], heldout: bool) -> list[dict]:
    """Smoothed excess over time, one series per session."""
    per_row, reported = found.nats.sum(1), []
    for s, r in enumerate(recordings):
        mine = np.flatnonzero(found.session == s)
        if len(mine) < 2:
            continue
        width = min(SMOOTH, len(mine))
        smooth = np.convolve(per_row[mine], np.ones(width) / width, mode="same")
        times = r.time_s[np.minimum(found.row[mine], len(r.time_s) - 1)] - r.time_s[0]
        reported.append({"session": r.name, "heldout": heldout, "time_s": times, "excess": smooth})
    return reported
