"""Whether an effect is restricted to a regime: where the recordings' rows are, and where the effect shows in them."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from simgap.diagnosis.innovations import Chunks
from simgap.effects.regime import EVERYWHERE, Regime, holds, values
from simgap.layout import Layout

FEWEST = 0.04
"""Share of the rows that a regime, and what lies outside, must have."""
SILENT = 4.0
"""Gain [nats] at most, besides `share` of what the effect gains inside, of an effect of another size outside."""


def of_rows(layout: Layout, chunks: Chunks) -> Float[np.ndarray, "n f"]:
    """The features of every row that counts, at the beginning of the step to it."""
    counts = np.asarray(chunks.counts)
    state, command = (np.asarray(a)[:, :-1][counts] for a in (chunks.state, chunks.command))
    return np.asarray(_every(layout, state, command))


def _every(layout: Layout, state: Float[np.ndarray, "n s"], command: Float[np.ndarray, "n u"]) -> Float[Array, "n f"]:
    return jax.vmap(lambda s, u: values(layout, s, u))(jnp.asarray(state), jnp.asarray(command))


def inside(layout: Layout, regime: Regime, chunks: Chunks) -> Bool[np.ndarray, "C T"]:
    """The rows of chunks that are in the regime."""
    return np.asarray(jax.vmap(jax.vmap(lambda s, u: holds(layout, regime, s, u)))(chunks.state, chunks.command))


def narrowest(
    found: Float[np.ndarray, "n f"], score: Float[np.ndarray, " n"], power: Float[np.ndarray, " n"], share: float
) -> tuple[Regime, float]:
    """The regime to which an effect is best restricted, and what the restriction gains [nats]; everywhere, if nothing.

    `score` and `power` are those of every row (see `when.scores`). Outside, where the effect must be silent, an effect
    of any other size may gain `SILENT` at most, and `share` of what the effect gains inside.
    """
    best, most = EVERYWHERE, 0.0
    throughout = _gain(score.sum(), power.sum())
    for k, column in enumerate(found.T):
        order = np.argsort(column, kind="stable")
        s, p = (np.cumsum(a[order]) for a in (score, power))
        ordered, fewest = column[order], int(np.ceil(FEWEST * len(column)))
        # Behind which rows an edge may lie: with a value belong all rows that have it.
        last = np.flatnonzero(ordered[:-1] < ordered[1:])
        last = last[(last + 1 >= fewest) & (last + 1 <= len(column) - fewest)]
        below, above = _gain(s[last], p[last]), _gain(s[-1] - s[last], p[-1] - p[last])
        for side, acting, silent in ((1.0, above, below), (-1.0, below, above)):
            more = np.where(silent < SILENT + share * acting, acting - throughout, 0.0)
            if more.max(initial=0.0) > most:
                i = int(more.argmax())
                edge = float(ordered[last[i]] + ordered[last[i] + 1]) / 2
                best, most = Regime(k, side, edge), float(more[i])
    return best, most


def _gain(score: np.ndarray, power: np.ndarray) -> np.ndarray:
    return 0.5 * score**2 / np.maximum(power, 1e-9)
