"""Segments with tables of an engine, computed along the filter's estimates."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from simgap.diagnosis.likelihood.filter import filtered
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.diagnosis.likelihood.sent import terms_in_rows
from simgap.diagnosis.likelihood.variables import Variables
from simgap.effects.augmented import Augmented
from simgap.effects.stepping import terms_of
from simgap.engines import Table, is_engine
from simgap.simulators.tables import Inputs, Points, shifted, tabulate


def tabulated(
    problem: Problem, v: Variables, chunks: Chunks, fits: Sequence[Fit] = (), derivatives: Table | None = None
) -> Chunks:
    """Segments with tables of the engine near the filter's estimates; unchanged if the simulator is no engine.

    fits: the tables serve these alone: parameters, and constants that act or are free in them. None given: all.
    derivatives: a table of these segments whose derivatives are good enough; only the next states are renewed.
    """
    augmented, engine = problem.augmented, problem.augmented.simulator
    if not is_engine(engine):
        return chunks
    chunks = chunks._replace(table=None)
    state, _, command = filtered(augmented, problem.scales, v, chunks, v.phi)
    # Where an estimate is not finite, use the measured state.
    x = np.where(np.isfinite(state), np.asarray(state), np.asarray(chunks.state)[:, :-1])
    scored = np.asarray(chunks.counts).any(1)  # the others are padding

    def by_row(a: Any) -> np.ndarray:
        kept = np.asarray(a)[scored]
        return kept.reshape(kept.shape[0] * kept.shape[1], *kept.shape[2:])  # some have no columns

    points = Points(np.asarray(v.phi), *map(by_row, (terms_in_rows(augmented, v, chunks), x, command)))
    if derivatives is None:
        table = tabulate(engine, points, _varied(augmented, fits) if fits else None)
    else:
        table = shifted(engine, points, jax.tree.map(by_row, derivatives))
    index = np.where(scored, np.cumsum(scored) - 1, 0)
    rows = scored.sum(), x.shape[1]
    return chunks._replace(table=jax.tree.map(lambda a: jnp.asarray(a.reshape(*rows, *a.shape[1:])[index]), table))


def _varied(augmented: Augmented, fits: Sequence[Fit]) -> Inputs:
    """The inputs that the effects in these fits change."""
    on = np.any([entries != 0 for fit in fits for entries in (fit.v.theta, *fit.v.delta)], axis=0)
    on[[entry for fit in fits for group in fit.groups for entry in group.entries]] = True
    places = {augmented.catalogue[effect].place for effect in augmented.effect_of[on]}
    terms = terms_of(augmented, on.astype(np.float32))
    return Inputs(bool(places & {"command", "filter"}), "push" in places, np.asarray(terms) != 0)
