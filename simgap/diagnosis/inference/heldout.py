"""What sessions that take no part in a fit say of it."""

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate
from simgap.diagnosis.likelihood.segments import Chunks, rows_of
from simgap.diagnosis.likelihood.student_t import log_density


def agrees(gained: Float[np.ndarray, " n"], heldout: float, chunks: Chunks, required: float) -> bool:
    """Whether held-out sessions that gain so many nats agree that something is there, with what fitted rows gain by it.

    They do where they gain. Where they lose, which they may by parameters that their motion depends on and the fitted
    sessions' hardly does, all sessions together must gain what is required without the one that speaks most for it.
    """
    if heldout > 0:
        return True
    by_session = np.bincount(rows_of(chunks).session, gained)
    return float(by_session.sum() - by_session.max()) + heldout > required


def by_row(without: Fit, with_it: Fit) -> Float[np.ndarray, " n"]:
    """Log-likelihood [nats] that every row gains."""
    return (log_density(with_it.e, with_it.noise) - log_density(without.e, without.noise)).sum(1)


def gain(problem: Problem, unseen: Chunks, without: Fit, with_it: Fit) -> float:
    """Log-likelihood [nats] that held-out sessions gain, all constants as fitted."""
    on = problem._replace(chunks=unseen)
    a, b = (evaluate(on, f.v, (), f.noise).loglik for f in (without, with_it))
    return b - a
