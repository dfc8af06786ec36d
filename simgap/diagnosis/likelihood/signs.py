"""Where segments begin if a sensor does not show the sign: of two states, the one that leads to the rows after it."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from simgap.diagnosis.likelihood.problem import Problem, trials
from simgap.diagnosis.likelihood.segments import until_last
from simgap.diagnosis.likelihood.student_t import fit_noise, log_density
from simgap.diagnosis.likelihood.variables import Variables
from simgap.effects.augmented import Augmented


def signed(problem: Problem, v: Variables, rows: Bool[np.ndarray, "C t"] | None = None) -> Problem:
    """The problem with segments that begin with the sign that makes their rows likelier.

    rows: those that decide; by default all up to the last scored one. Unchanged unless a sensor loses the sign in v.
    """
    scored = problem.chunks.counts
    decide = until_last(np.asarray(scored)) if rows is None else rows
    for output in _folded(problem.augmented, v):
        state = np.array(problem.chunks.state)
        e = []
        for sign in (1, -1):
            state[:, 0, output] = sign * np.abs(state[:, 0, output])
            begun = problem._replace(chunks=problem.chunks._replace(state=jnp.array(state), counts=decide))
            e.append(trials(begun, [v])[0])
        noise, segment = fit_noise(e[0]), np.nonzero(decide)[0]
        likely = [np.bincount(segment, log_density(one, noise).sum(1), len(decide)) for one in e]
        state[:, 0, output] *= np.where(likely[1] > likely[0], 1, -1)
        problem = problem._replace(chunks=problem.chunks._replace(state=jnp.asarray(state), counts=scored))
    return problem


def _folded(augmented: Augmented, v: Variables) -> list[int]:
    """Outputs of which a sensor shows negative values as positive ones, or nearly so."""
    return sorted({augmented.slots[i].site for i in np.flatnonzero(augmented.folding & (np.asarray(v.theta) != 0))})
