"""Maximum likelihood of the innovations: Gauss-Newton with the weights of Student's t noise."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from simgap.diagnosis.likelihood.derivatives import constant_columns, nuisance_columns
from simgap.diagnosis.likelihood.directions import directions, prior_offset, room_to_move, step_from
from simgap.diagnosis.likelihood.filter import Variables
from simgap.diagnosis.likelihood.problem import Fit, Problem, trials
from simgap.diagnosis.likelihood.student_t import fit_noise, log_density, weights
from simgap.types import DivergenceError

NARROW = 1e-9
"""Added to bounds, which must not touch [root nats]."""
ROUNDING = 1e-6
"""Least curvature of a Hessian with a diagonal of ones; what lies below, or below zero, is the products' rounding."""
SHARES = (1.0, 0.5, 0.2, 0.05)
"""Of a Gauss-Newton step, tried one after the other, until one"""
ENOUGH = 0.5
"""gains this share of what it should, were the model linear."""
CONVERGED = 0.5
"""Gain [nats] below which iterations end."""
WORTHWHILE = 0.1
"""Share of what the first step with some derivatives gained, below which further ones are left to derivatives anew."""
HELD = 4
"""Steps taken with the same derivatives by phi and K."""
RENEWALS = 6
"""How often these are renewed at most."""


class Held(NamedTuple):
    """Derivatives that are kept for several steps; gram: of each output's, at the weights."""

    columns: Float[np.ndarray, "M n s"]
    weights: Float[np.ndarray, "n s"]
    gram: Float[np.ndarray, "s M M"]


def hold(fit: Fit, columns: Float[np.ndarray, "M n s"]) -> Held:
    """Derivatives at a fit."""
    w = weights(fit.e, fit.noise).astype(np.float32)
    outputs = np.moveaxis(columns, 2, 0)
    return Held(columns, w, np.stack([(c * each) @ c.T for c, each in zip(outputs, w.T, strict=True)]))


def gauss_newton(
    problem: Problem,
    fit: Fit,
    held: Held,
    renewed: Float[np.ndarray, "k n s"],
    precision: Float[np.ndarray, " M+k"],
) -> Fit:
    """One step from `fit` along all its free directions; the best of the lengths tried, or `fit` itself.

    The gradient is that at `fit`; of the Hessian, whose products are dear, only the level of its weights is.
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
    # What the recordings do not depend on, or not by a finite derivative, stays where it is.
    down, up = (np.where(np.diag(curvature) > 0, room, 0.0) for room in room_to_move(problem, fit.v, fit.groups))
    delta = lowest(hessian, gradient, down, up)

    def value(e: np.ndarray, v: Variables) -> float:
        if not np.isfinite(e).all():
            return -np.inf
        away = prior_offset(problem, v, fit.groups)
        return float(log_density(e, fit.noise).sum()) - 0.5 * float(precision @ away**2)

    slope, bend = -float(delta @ gradient), float(delta @ hessian @ delta)
    now, best = value(fit.e, fit.v), None
    for share in SHARES:
        v = step_from(problem, fit.v, fit.groups, share * delta)
        e = trials(problem, [v])[0]
        gain = value(e, v) - now
        if best is not None and gain < best[0]:
            break  # beyond the best length
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
    """Where g x + x H x / 2 is lowest within bounds.

    Were an unbounded step cut to them afterwards, what is at no bound would have gone along with what is, for nothing.
    """
    scale = np.sqrt(np.diag(hessian))
    curvature, axes = np.linalg.eigh(hessian / np.outer(scale, scale))
    root = np.sqrt(np.maximum(curvature, ROUNDING))
    target = -(axes.T @ (gradient / scale)) / root
    bounds = down * scale - NARROW, up * scale + NARROW
    return np.clip(lsq_linear(root[:, None] * axes.T, target, bounds, method="bvls").x / scale, down, up)


def refine(problem: Problem, fit: Fit, held: Held, iterations: int) -> Fit:
    """Gauss-Newton with some derivatives held, those by phi, K and the first of the constants, the others renewed."""
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
    """Gauss-Newton until its steps gain less than `enough` [nats]; returns the derivatives by phi and K as well.

    These cost as much as ten steps with them: they are renewed only when they have led as far as they can. Raises
    DivergenceError when the start leaves the finite numbers.
    """
    if not np.isfinite(fit.loglik):
        raise DivergenceError(
            "the simulator leaves the finite numbers on these recordings at its nominal parameters. "
            "Check its units and its time step."
        )
    nuisance = nuisance_columns(problem, fit.v)
    for _ in range(RENEWALS):
        improved = refine(problem, fit, hold(fit, nuisance), HELD)
        gain = improved.loglik - fit.loglik
        fit = improved
        if gain < enough:
            break
        nuisance = nuisance_columns(problem, fit.v)
    return fit, nuisance
