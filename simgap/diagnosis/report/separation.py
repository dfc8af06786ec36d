"""How clearly runs of an experiment would separate two models, as the recordings left them and refitted."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.hypotheses.features import inside
from simgap.diagnosis.inference.fitting.gauss_newton import hold, lowest
from simgap.diagnosis.inference.fitting.model import Model, absorbing
from simgap.diagnosis.likelihood.derivatives import nuisance_columns
from simgap.diagnosis.likelihood.directions import directions, room_to_move
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate
from simgap.diagnosis.likelihood.segments import LENGTH, cut, rows_of
from simgap.diagnosis.likelihood.student_t import log_density
from simgap.diagnosis.validation.forecast import Regimes
from simgap.types import Recording

Run = tuple[np.ndarray, np.ndarray]
"""Commands [T, u], and the measurements [T, s] that a model predicts: y[t] is measured after command u[t]."""


def apart(problem: Problem, a: Fit, b: Fit, runs: Sequence[Run], regimes: Regimes) -> Float[np.ndarray, " runs"]:
    """Log-likelihood ratio [nats] of a over b on each run, predicted by a, with a's noise. -inf where b diverges.

    It is a sum over one-step predictions, as in a diagnosis: errors that only add up over seconds are no evidence.
    """
    ratios = []
    for posed in _posed(problem, runs, regimes):
        own, other = (evaluate(posed, f.v, (), a.noise) for f in (a, b))
        with np.errstate(invalid="ignore", over="ignore"):
            nats = (log_density(own.e, a.noise) - log_density(other.e, a.noise)).sum(1)
        total = np.bincount(rows_of(posed.chunks).session, nats)
        ratios.append(np.where(np.isfinite(total), total, -np.inf))
    return np.concatenate(ratios)


def apart_refitted(
    problem: Problem, a: Fit, b: Fit, runs: Sequence[Run], regimes: Regimes, repeats: int
) -> Float[np.ndarray, " runs"]:
    """The same for `repeats` repeats of each run, after b has been fitted again to the recordings and these together.

    What b then loses on the recordings counts as well. b is taken to be linear in what is free, within its bounds.
    """
    held = hold(b, _slopes(problem, b))
    known = held.gram.sum(0) + np.diag(directions(problem, b.groups)[1])
    room, weight = room_to_move(problem, b.v, b.groups), repeats * held.weights.mean(0)
    ratios = []
    for posed in _posed(problem, runs, regimes):
        own, other = (evaluate(posed, f.v, (), a.noise).e for f in (a, b))
        slopes, run = _slopes(posed, b), rows_of(posed.chunks).session
        for rows in (run == k for k in np.unique(run)):
            e, J = other[rows], slopes[:, rows]
            if not np.isfinite(e).all():
                ratios.append(-np.inf)
                continue
            weighed = J * weight
            move = lowest(known + np.tensordot(weighed, J, ((1, 2), (1, 2))), np.tensordot(weighed, e, 2), *room)
            nats = log_density(own[rows], a.noise) - log_density(e + np.tensordot(move, J, 1), a.noise)
            ratios.append(repeats * float(nats.sum()) + 0.5 * float(move @ known @ move))
    return np.array(ratios)


def _slopes(problem: Problem, fit: Fit) -> Float[np.ndarray, "M n s"]:
    """Derivatives of the innovations by all that is free in a fit."""
    return absorbing(Model(problem, fit, nuisance_columns(problem, fit.v)))


def _posed(problem: Problem, runs: Sequence[Run], regimes: Regimes) -> list[Problem]:
    """The runs as sessions to explain, in batches as large as the recordings: programs of that size are compiled."""
    dt, least = problem.scales.time_step, len(problem.chunks.row)
    # y[t] is measured after command u[t], so it is in one row with u[t + 1].
    sessions = [
        Recording(str(i), np.arange(len(u)) * dt, y, np.concatenate([u[1:], u[-1:]])) for i, (u, y) in enumerate(runs)
    ]
    at_once = max(least // -(-len(sessions[0].time_s) // LENGTH), 1)
    posed = []
    for first in range(0, len(sessions), at_once):
        chunks = cut(sessions[first : first + at_once], dt, least)
        gate = np.stack([inside(problem.augmented.layout, r, chunks) for r in regimes], axis=1).astype(np.float32)
        posed.append(problem._replace(chunks=chunks._replace(gate=gate)))
    return posed
