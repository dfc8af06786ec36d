"""Starts of unmeasured states, fitted together with the model that says what follows from them.

Fitted in turns, each would stay near the other: starts that were guessed with wrong parameters keep these wrong.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from simgap.diagnosis.inference.fitting.gauss_newton import SHARES, lowest
from simgap.diagnosis.inference.fitting.model import SETTLED
from simgap.diagnosis.likelihood.derivatives import constant_columns, nuisance_columns
from simgap.diagnosis.likelihood.directions import directions, prior_offset, room_to_move, step_from
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, trials
from simgap.diagnosis.likelihood.segments import until_last
from simgap.diagnosis.likelihood.signs import signed
from simgap.diagnosis.likelihood.student_t import log_density, weights
from simgap.diagnosis.likelihood.unmeasured import by_start, chained, sloped
from simgap.diagnosis.likelihood.variables import Variables
from simgap.engines import is_engine

STEPS = 20
"""Gauss-Newton steps at most."""
AROUND = (-1.0, -0.3, -0.1, -0.03, 0.03, 0.1, 0.3, 1.0)
"""Distances from a start that are tried where slopes lead no further, in usual sizes."""


def fitted_starts(problem: Problem, fit: Fit, free: bool = True) -> tuple[Problem, Fit]:
    """The problem with segments whose unmeasured states begin where the model leads them in the segment before; and the
    fit's parameters and constants, if they are `free`. Unchanged without unmeasured states, or where the fit diverges.

    For this, all segments first begin where their own rows are likeliest, also those that are not scored. A step away
    from a start costs as much as from a prior of its usual size: one on which nothing measured depends stays.
    """
    if problem.augmented.layout.observed.all():
        return problem, fit
    scored = problem.chunks.counts
    begun = problem._replace(chunks=problem.chunks._replace(counts=until_last(np.asarray(scored))))
    now = _Begun(begun, evaluate(begun, fit.v, fit.groups))
    if not np.isfinite(now.fit.loglik):
        return problem, fit
    for _ in range(STEPS):
        before = now.fit.loglik
        now = _step(now, free)
        if now.fit.loglik - before < SETTLED:
            now = _scattered(now)
        if now.fit.loglik - before < SETTLED:
            break
    problem, fit = now
    problem = problem._replace(chunks=chained(problem, fit.v)._replace(counts=scored))
    return problem, evaluate(problem, fit.v, fit.groups)


def begun_anew(problem: Problem, fit: Fit, free: bool = True) -> tuple[Problem, Fit]:
    """As `fitted_starts`, while fits are compared: otherwise an effect could gain by making up for wrong starts. Also
    with the signs that a sensor does not show (`signed`).

    Other starts stay unless they are `led` by the model. Slopes of positions are good guesses of velocities without any
    model; starts fitted by a model that lacks an effect would hide that effect.
    """
    begun = signed(problem, fit.v)
    if begun is not problem:
        problem, fit = begun, evaluate(begun, fit.v, fit.groups)
    return fitted_starts(problem, fit, free) if led(problem) else (problem, fit)


def led(problem: Problem) -> bool:
    """Whether only the model says where some unmeasured states begin: no slope of a position does. An engine's tables
    hold only near the starts with which they were made."""
    layout = problem.augmented.layout
    return len(sloped(layout)) < (~layout.observed).sum() and not is_engine(problem.augmented.simulator)


class _Begun(NamedTuple):
    """A problem whose segments begin with some unmeasured states, and a fit there."""

    problem: Problem
    fit: Fit

    @property
    def hidden(self) -> Bool[np.ndarray, " s"]:
        return ~self.problem.augmented.layout.observed

    @property
    def usual(self) -> Float[np.ndarray, " k"]:
        """Usual sizes of the unmeasured states."""
        return np.asarray(self.problem.scales.output)[self.hidden]

    def moved(self, moves: Float[np.ndarray, "C k"]) -> Problem:
        """The problem whose segments begin that much further on."""
        state = np.array(self.problem.chunks.state)
        state[:, 0, self.hidden] += moves
        return self.problem._replace(chunks=self.problem.chunks._replace(state=jnp.asarray(state)))

    def best_of(self, v: Variables, moves: Sequence[Float[np.ndarray, "C k"]]) -> "_Begun":
        """With other variables, and each segment with the one of some moves of its start that pays most."""
        counts, noise = np.asarray(self.problem.chunks.counts), self.fit.noise
        segment, likely = np.nonzero(counts)[0], []
        for move in moves:
            (e,) = trials(self.moved(move), [v])
            rows = np.bincount(segment, log_density(e, noise).sum(1), len(counts))
            likely.append(np.nan_to_num(rows, nan=-np.inf) - 0.5 * ((move / self.usual) ** 2).sum(1))
        problem = self.moved(np.stack(moves)[np.argmax(likely, axis=0), np.arange(len(counts))])
        return _Begun(problem, evaluate(problem, v, self.fit.groups))


class _Rows(NamedTuple):
    """Innovations and their derivatives, scaled by the roots of their weights, segment by segment.

    by_start, by_rest: by the segment's own starts, and by all that is free otherwise.
    """

    e: Float[np.ndarray, "C m"]
    by_start: Float[np.ndarray, "C k m"]
    by_rest: Float[np.ndarray, "M C m"]


def _rows(problem: Problem, fit: Fit, free: bool) -> _Rows:
    counts, outputs = np.asarray(problem.chunks.counts), fit.e.shape[1]

    def whole(scored: Float[np.ndarray, "... n o"]) -> Float[np.ndarray, "... C m"]:
        """Zero where a row does not count."""
        rows = np.zeros((*scored.shape[:-2], counts.size, outputs), np.float32)
        rows[..., np.flatnonzero(counts), :] = scored
        return rows.reshape(*scored.shape[:-2], len(counts), counts.shape[1] * outputs)

    root = np.sqrt(weights(fit.e, fit.noise)).astype(np.float32)
    rest = np.zeros((0, *fit.e.shape), np.float32)
    if free:
        nuisance, count = nuisance_columns(problem, fit.v), len(fit.v.phi)
        # The filter's gain stays: next to starts that know what comes, less correction would look best.
        held = np.zeros_like(nuisance[count:])
        rest = np.concatenate([nuisance[:count], held, constant_columns(problem, fit.v, fit.groups)])
    slopes = np.asarray(by_start(problem.augmented, problem.scales, fit.v, problem.chunks)) @ problem.whiten.T
    slopes = slopes.reshape(*slopes.shape[:2], -1) * whole(root)[:, None]
    return _Rows(whole(fit.e * root), np.where(np.isfinite(slopes), slopes, 0.0), whole(rest * root))


def _step(now: _Begun, free: bool) -> _Begun:
    """One step of the starts and of what else is free: the longest tried that gains, or none."""
    problem, fit = now
    e, J, A = _rows(problem, fit, free)
    inverse = np.linalg.inv(J @ np.swapaxes(J, 1, 2) + np.diag(now.usual**-2.0))
    delta = np.zeros(len(A))
    if free:
        _, precision = directions(problem, fit.groups)
        # What the starts can take out of a direction says nothing about it.
        mixed = np.einsum("ckm,acm->cka", J, A)
        solved = inverse @ mixed
        curvature = np.tensordot(A, A, ([1, 2], [1, 2])) - np.tensordot(mixed, solved, ([0, 1], [0, 1]))
        gradient = np.tensordot(A, e, 2) - np.einsum("cka,ckm,cm->a", solved, J, e)
        gradient = gradient + precision * prior_offset(problem, fit.v, fit.groups)
        hessian = curvature + np.diag(precision)
        if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
            return now
        room = room_to_move(problem, fit.v, fit.groups)
        down, up = (np.where(np.diag(curvature) > 0, r, 0.0) for r in room)
        delta = lowest(hessian.astype(float), gradient.astype(float), down, up)
    moves = -np.einsum("ckl,clm,cm->ck", inverse, J, e + np.tensordot(delta, A, 1))
    for share in SHARES if free else (0.0,):
        v = step_from(problem, fit.v, fit.groups, share * delta) if free else fit.v
        then = now.best_of(v, [part * moves for part in (*SHARES, 0.0)])
        if then.fit.loglik > fit.loglik:
            return then
    return now


def _scattered(now: _Begun) -> _Begun:
    """Starts of states that are `apart` at the best of some values around where they are, one state at a time: slopes
    there may lead nowhere, such as those of an empty tank."""
    layout = now.problem.augmented.layout
    for k in np.flatnonzero(layout.apart[~layout.observed]):
        along = np.tile(np.eye(len(now.usual))[k] * now.usual, (len(now.problem.chunks.row), 1))
        now = now.best_of(now.fit.v, [share * along for share in (0.0, *AROUND)])
    return now
