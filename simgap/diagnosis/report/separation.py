"""How clearly runs of an experiment would separate two models, as the recordings left them and refitted."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from simgap.diagnosis.hypotheses.features import inside
from simgap.diagnosis.inference.gauss_newton import hold, lowest
from simgap.diagnosis.likelihood.derivatives import constant_columns, nuisance_columns
from simgap.diagnosis.likelihood.directions import directions, room_to_move
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate
from simgap.diagnosis.likelihood.segments import LENGTH, cut
from simgap.diagnosis.likelihood.student_t import log_density
from simgap.diagnosis.validation.forecast import Regimes
from simgap.types import Recording

Run = tuple[np.ndarray, np.ndarray]
"""Commands [T, u], and the measurements [T, s] that a model predicts: y[t] is measured after command u[t]."""


class _Posed(NamedTuple):
    """Some runs as recordings to explain. run: to which each row belongs. size: number of runs."""

    problem: Problem
    run: Int[np.ndarray, " n"]
    size: int


def apart(problem: Problem, a: Fit, b: Fit, runs: Sequence[Run], regimes: Regimes) -> Float[np.ndarray, " runs"]:
    """Log-likelihood ratio [nats] of a over b on each run, predicted by a, with a's noise. -inf where b diverges.

    It is a sum over one-step predictions, as in a diagnosis: errors that only add up over seconds are no evidence.
    """
    ratios = []
    for posed in _posed(problem, runs, regimes):
        own, other = (evaluate(posed.problem, f.v, (), a.noise) for f in (a, b))
        with np.errstate(invalid="ignore", over="ignore"):
            nats = (log_density(own.e, a.noise) - log_density(other.e, a.noise)).sum(1)
        total = np.bincount(posed.run, nats, posed.size)
        ratios.append(np.where(np.isfinite(total), total, -np.inf))
    return np.concatenate(ratios)


def apart_refitted(
    problem: Problem, a: Fit, b: Fit, runs: Sequence[Run], regimes: Regimes, repeats: int
) -> Float[np.ndarray, " runs"]:
    """The same of each run `repeats` times, after all that is free in b has been fitted again, to the recordings too.

    What b then loses on the recordings counts as well. b is taken to be linear in what is free, within its bounds.
    """
    held = hold(b, np.concatenate([nuisance_columns(problem, b.v), constant_columns(problem, b.v, b.groups)]))
    known = held.gram.sum(0) + np.diag(directions(problem, b.groups)[1])
    room, level = room_to_move(problem, b.v, b.groups), repeats * held.weights.mean(0)
    ratios = []
    for posed in _posed(problem, runs, regimes):
        own, other = (evaluate(posed.problem, f.v, (), a.noise).e for f in (a, b))
        slopes = [nuisance_columns(posed.problem, b.v), constant_columns(posed.problem, b.v, b.groups)]
        columns = np.concatenate(slopes)
        for k in range(posed.size):
            e, J = other[posed.run == k], columns[:, posed.run == k]
            if not np.isfinite(e).all():
                ratios.append(-np.inf)
                continue
            weighed = J * level
            move = lowest(known + np.tensordot(weighed, J, ((1, 2), (1, 2))), np.tensordot(weighed, e, 2), *room)
            refitted = e + np.tensordot(move, J, 1)
            nats = log_density(own[posed.run == k], a.noise) - log_density(refitted, a.noise)
            ratios.append(repeats * float(nats.sum()) + 0.5 * float(move @ known @ move))
    return np.array(ratios)


def _posed(problem: Problem, runs: Sequence[Run], regimes: Regimes) -> list[_Posed]:
    """The runs in batches, as large as the recordings: programs of that size are compiled."""
    dt, least = problem.scales.time_step, len(problem.chunks.row)
    # y[t] is measured after command u[t], so it is in one row with u[t + 1].
    sessions = [
        Recording(str(i), np.arange(len(u)) * dt, y, np.concatenate([u[1:], u[-1:]])) for i, (u, y) in enumerate(runs)
    ]
    at_once = max(least // -(-len(sessions[0].time_s) // LENGTH), 1)
    posed = []
    for first in range(0, len(sessions), at_once):
        batch = sessions[first : first + at_once]
        chunks = cut(batch, dt, least)
        gate = np.stack([inside(problem.augmented.layout, r, chunks) for r in regimes], axis=1).astype(np.float32)
        ends = np.cumsum(np.asarray(chunks.counts).sum(1))
        run = np.repeat(chunks.session, np.diff(ends, prepend=0))
        posed.append(_Posed(problem._replace(chunks=chunks._replace(gate=gate)), run, len(batch)))
    return posed
