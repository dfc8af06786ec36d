"""Segments with tables of an engine, computed along the filter's estimates."""

import jax
import jax.numpy as jnp
import numpy as np

from simgap.diagnosis.likelihood.filter import Variables, acting, filtered, sent_of
from simgap.diagnosis.likelihood.problem import Problem
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.effects.stepping import terms_of
from simgap.engines import is_engine
from simgap.simulators.tables import Points, tabulate


def tabulated(problem: Problem, v: Variables, chunks: Chunks) -> Chunks:
    """Segments with tables of the engine near the filter's estimates; unchanged if the simulator is no engine."""
    augmented = problem.augmented
    if not is_engine(augmented.simulator):
        return chunks
    chunks = chunks._replace(table=None)
    (state, _), command = filtered(augmented, problem.scales, v, chunks), sent_of(augmented, v, chunks)
    gates = jnp.swapaxes(chunks.gate[..., :-1], 1, 2)
    terms = jax.vmap(jax.vmap(lambda gate: terms_of(augmented, acting(v, v.theta, gate))))(gates)
    assert terms is not None  # an engine has them
    # Where an estimate is not finite, use the measured state.
    x = np.where(np.isfinite(state), np.asarray(state), np.asarray(chunks.state)[:, :-1])
    scored = np.asarray(chunks.counts).any(1)  # the others are padding
    inputs = [np.asarray(a)[scored] for a in (terms, x, command)]
    table = tabulate(augmented.simulator, Points(np.asarray(v.phi), *(a.reshape(-1, *a.shape[2:]) for a in inputs)))
    index = np.where(scored, np.cumsum(scored) - 1, 0)
    return chunks._replace(
        table=jax.tree.map(lambda a: jnp.asarray(a.reshape(*inputs[0].shape[:2], *a.shape[1:])[index]), table)
    )
