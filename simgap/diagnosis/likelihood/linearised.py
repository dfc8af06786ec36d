"""Segments with tables of an engine, made where a filter with some variables comes along."""

import jax
import numpy as np

from simgap.diagnosis.likelihood.filter import Variables, asked, filtered
from simgap.diagnosis.likelihood.problem import Problem
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.engines import is_engine
from simgap.simulators.tables import Points, tabulate


def tabulated(problem: Problem, v: Variables, chunks: Chunks) -> Chunks:
    """Segments with what an engine does near the filter's estimates; as they are, where the simulator is no engine."""
    augmented = problem.augmented
    if not is_engine(augmented.simulator):
        return chunks
    chunks = chunks._replace(table=None)
    (state, _), (terms, command) = filtered(augmented, problem.scales, v, chunks), asked(augmented, v, chunks)
    # Where the filter left the finite numbers, what was measured is the best there is.
    x = np.where(np.isfinite(state), state, chunks.state[:, :-1])
    at = (a.reshape(-1, *a.shape[2:]) for a in (terms, x, command))
    table = tabulate(augmented.simulator, Points(np.asarray(v.phi), *at))
    return chunks._replace(table=jax.tree.map(lambda a: np.asarray(a).reshape(*x.shape[:2], *a.shape[1:]), table))
