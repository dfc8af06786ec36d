"""Held-out check: do sessions that take no part in a fit confirm it?"""

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.inference.fitting.starts import begun_anew
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate
from simgap.diagnosis.likelihood.segments import Chunks, rows_of
from simgap.diagnosis.likelihood.student_t import log_density


def agrees(gained: Float[np.ndarray, " n"], heldout: float, chunks: Chunks, required: float) -> bool:
    """Whether held-out sessions confirm an effect. gained: by each fitted row [nats]; heldout: by all of them [nats].

    They confirm it if they gain. They may also lose because of parameters that matter for their motion, but hardly for
    that of the fitted sessions. Then all sessions but the fitted one that gains most must gain more than `required`.
    """
    if heldout > 0:
        return True
    by_session = np.bincount(rows_of(chunks).session, gained)
    return float(by_session.sum() - by_session.max()) + heldout > required


def by_row(without: Fit, with_it: Fit) -> Float[np.ndarray, " n"]:
    """Gain in log-likelihood of every row [nats]."""
    return (log_density(with_it.e, with_it.noise) - log_density(without.e, without.noise)).sum(1)


def gain(problem: Problem, unseen: Chunks, without: Fit, with_it: Fit) -> float:
    """Gain in log-likelihood of held-out sessions [nats], with all constants as fitted. Unmeasured states begin where
    either fit has them begin."""

    def loglik(fit: Fit) -> float:
        heldout, _ = begun_anew(problem._replace(chunks=unseen), fit, free=False)
        return evaluate(heldout, fit.v, (), fit.noise).loglik

    return loglik(with_it) - loglik(without)
