"""Maximum likelihood of the innovations: Gauss-Newton with the weights of Student's t noise."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from simgap.diagnosis.likelihood.derivatives import constant_columns, nuisance_columns
from simgap.diagnosis.likelihood.directions import directions, prior_offset, room_to_move, step_from
from simgap.diagnosis.likelihood.problem import Fit, Problem, trials
from simgap.diagnosis.likelihood.student_t import fit_noise, log_density, weights
from simgap.diagnosis.likelihood.variables import Variables
from simgap.types import DivergenceError

NARROW = 1e-9
"""Margin added to bounds, whose ends must differ [root nats]."""
ROUNDING = 1e-6
"""Minimum eigenvalue of a Hessian with a diagonal of ones. Smaller or negative ones are rounding errors."""
SHARES = (1.0, 0.5, 0.2, 0.05)
"""Step lengths, as shares of the Gauss-Newton step, tried in this order until one reaches `ENOUGH`."""
ENOUGH = 0.5
"""A step length is accepted if it gains this share of what a linear model would."""
CONVERGED = 0.5
"""Gain [nats] of an iteration below which iterations end."""
WORTHWHILE = 0.1
"""Share of the largest gain of a step with held derivatives. A step that gains less is the last with them."""
HELD = 4
"""Steps with the same derivatives by phi and K, at most."""
RENEWALS = 6
"""Renewals of these derivatives, at most."""


class Held(NamedTuple):
    """Derivatives held for several steps. gram: Gram matrix of each output's derivatives, at the weights."""

    columns: Float[np.ndarray, "M n s"]
    weights: Float[np.ndarray, "n s"]
    gram: Float[np.ndarray, "s M M"]


def hold(fit: Fit, columns: Float[np.ndarray, "M n s"]) -> Held:
    """Hold derivatives, with their weights at a fit."""
    w = weights(fit.e, fit.noise).astype(np.float32)
    scaled = np.ascontiguousarray((columns * np.sqrt(w)).transpose(2, 0, 1))
    return Held(columns, w, scaled @ scaled.transpose(0, 2, 1))


def gauss_newton(
    problem: Problem,
    fit: Fit,
    held: Held,
    renewed: Float[np.ndarray, "k n s"],
    precision: Float[np.ndarray, " M+k"],
) -> Fit:
    """One step from `fit` along all its free directions: the best length tried, or `fit` itself if none gains.

    The gradient is the one at `fit`. The Hessian's products are expensive, so only the level of its weights is updated.
    """
    if not len(fit.e):
        return fit
    w = weights(fit.e, fit.noise).astype(np.float32)
    level, k = w.mean(0) / held.weights.mean(0), len(renewed)
    rows = np.concatenate([renewed * (held.weights * level), [w * fit.e]]).reshape(k + 1, -1)
    by_held, by_renewed = (rows @ c.reshape(len(c), rows.shape[1]).T for c in (held.columns, renewed))
    offset = prior_offset(problem, fit.v, fit.groups)
    upper = np.hstack([np.tensordot(level, held.gram, 1), by_held[:k].T])
    curvature = np.vstack([upper, np.hstack([by_held[:k], by_renewed[:k]])]).astype(np.float64)
    hessian = curvature + np.diag(precision)
    gradient = np.concatenate([by_held[k], by_renewed[k]]).astype(np.float64) + precision * offset
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
        return fit
    # A direction without information, or without a finite derivative, stays where it is.
    down, up = (np.where(np.diag(curvature) > 0, room, 0.0) for room in room_to_move(problem, fit.v, fit.groups))
    delta = lowest(hessian, gradient, down, up)

    def value(e: np.ndarray, v: Variables) -> float:
        if not np.isfinite(e).all():
            return -np.inf
        from_prior = prior_offset(problem, v, fit.groups)
        return float(log_density(e, fit.noise).sum()) - 0.5 * float(precision @ from_prior**2)

    slope, bend = -float(delta @ gradient), float(delta @ hessian @ delta)
    now, best = value(fit.e, fit.v), None
    for share in SHARES:
        v = step_from(problem, fit.v, fit.groups, share * delta)
        e = trials(problem, [v])[0]
        gain = value(e, v) - now
        if best is not None and gain < best[0]:
            break  # shorter ones are worse
        if gain > 0:
            best = gain, v, e
        if gain > ENOUGH * (slope * share - bend * share**2 / 2):
            break
    if best is None:
        return fit
    _, v, e = best
    noise = fit_noise(e)
    return Fit(v, fit.groups, e, noise, float(log_density(e, noise).sum()))


def lowest(
    hessian: Float[np.ndarray, "m m"],
    gradient: Float[np.ndarray, " m"],
    down: Float[np.ndarray, " m"],
    up: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """The x within bounds that minimises g x + x H x / 2.

    Clipping an unbounded step would not do: its other entries would still compensate for what is clipped.
    """
    scale = np.sqrt(np.diag(hessian))
    curvature, axes = np.linalg.eigh(hessian / np.outer(scale, scale))
    root = np.sqrt(np.maximum(curvature, ROUNDING))
    target = -(axes.T @ (gradient / scale)) / root
    unbounded = axes @ (target / root) / scale
    if (down <= unbounded).all() and (unbounded <= up).all():  # as of most steps; the bounded solver takes longer
        return unbounded
    bounds = down * scale - NARROW, up * scale + NARROW
    return np.clip(lsq_linear(root[:, None] * axes.T, target, bounds, method="bvls").x / scale, down, up)


def refine(problem: Problem, fit: Fit, held: Held, iterations: int) -> Fit:
    """Gauss-Newton with the derivatives by phi, K and the first constants held, and the others renewed every step."""
    _, precision = directions(problem, fit.groups)
    renewed = fit.groups[len(held.columns) + len(fit.groups) - len(precision) :]
    most = 0.0
    for _ in range(iterations):
        improved = gauss_newton(problem, fit, held, constant_columns(problem, fit.v, renewed), precision)
        gain = improved.loglik - fit.loglik
        fit, most = improved, max(most, gain)
        if gain < max(CONVERGED, WORTHWHILE * most):
            break
    return fit


def optimise(problem: Problem, fit: Fit, enough: float = CONVERGED) -> tuple[Fit, Float[np.ndarray, "M n s"]]:
    """Gauss-Newton until it gains less than `enough` [nats]. Also returns the derivatives by phi and K at its end.

    These cost as much as ten steps, so they are renewed only when steps with the held ones gain no more. They depend on
    K, which is still on its way when hardly anything is gained: those held before would let what parameters imitate
    pass for an effect. Raises DivergenceError if the simulator diverges at the start.
    """
    if not np.isfinite(fit.loglik):
        raise DivergenceError(
            "the simulator diverges (NaN or infinity) on these recordings at its nominal parameters. "
            "Check its units and its time step."
        )
    nuisance = nuisance_columns(problem, fit.v)
    for _ in range(RENEWALS):
        improved = refine(problem, fit, hold(fit, nuisance), HELD)
        gain = improved.loglik - fit.loglik
        if improved is not fit:
            fit, nuisance = improved, nuisance_columns(problem, improved.v)
        if gain < enough:
            break
    return fit, nuisance
