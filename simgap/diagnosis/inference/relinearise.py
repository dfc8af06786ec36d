"""Fits of an engine, whose tables hold only near the point where they were made: they are renewed as a fit moves."""

import numpy as np

from simgap.diagnosis.inference.gauss_newton import optimise
from simgap.diagnosis.inference.model import SETTLED, Model, Trial
from simgap.diagnosis.likelihood.directions import bounds_of
from simgap.diagnosis.likelihood.linearised import tabulated
from simgap.diagnosis.likelihood.problem import NEAR, Fit, Problem, evaluate, value_of, with_value
from simgap.engines import is_engine

SIZES = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors on an effect's fitted constants that are tried on an engine itself."""
RENEWALS = 4
"""How often tables are made for one fit, at most."""


def relinearised(problem: Problem, fit: Fit, reach: float = NEAR) -> tuple[Problem, Fit]:
    """Continue the fit, with new tables where it leads, until it has converged. Without an engine nothing changes.

    reach: how far the parameters may move with one table.
    """
    if not is_engine(problem.augmented.simulator):
        return problem, fit
    for _ in range(RENEWALS):
        chunks = tabulated(problem, fit.v, problem.chunks)
        problem = problem._replace(chunks=chunks, near=np.asarray(fit.v.phi), reach=reach)
        initial = evaluate(problem, fit.v, fit.groups)
        if not np.isfinite(initial.loglik):
            return problem, initial
        fit, _ = optimise(problem, initial)
        if fit.loglik - initial.loglik < SETTLED:
            break
    return problem, fit


def standing(problem: Problem) -> Problem:
    """The problem with the parameters held where an engine was tabulated; unchanged without an engine."""
    return problem._replace(reach=0.0) if is_engine(problem.augmented.simulator) else problem


def carried_on(problem: Problem, tried: Trial, without: Fit) -> tuple[Problem, Trial]:
    """Continue a hypothesis' fit with tables of its own. The gain is over the model `without` it."""
    if not is_engine(problem.augmented.simulator):
        return problem, tried
    fit = tried.fit
    if tried.hypothesis.effect.place == "engine":
        # First with the parameters held: otherwise they compensate for a wrong size of the effect, and stay there.
        problem, fit = relinearised(problem, _sized(problem, tried), reach=0.0)
    problem, fit = relinearised(problem, fit)
    return problem, Trial.of(tried.hypothesis, fit, without, tried.expected, tried.share)


def _sized(problem: Problem, tried: Trial) -> Fit:
    """The fit with the constants of an engine's own effect scaled to the size with which the engine itself fits best.

    A limit is far from linear: tables made at one size lead to another that is far too tight or too loose.
    """
    engine, groups = itself(problem), tried.hypothesis.groups
    fits = []
    for share in SIZES:
        v = tried.fit.v
        for group in groups:
            low, high = bounds_of(problem, v, group)
            v = with_value(v, group, float(np.clip(share * value_of(v, group), low, high)))
        fits.append(tried.fit._replace(v=v, loglik=evaluate(engine, v, tried.fit.groups, tried.fit.noise).loglik))
    return max(fits, key=lambda fit: np.nan_to_num(fit.loglik, nan=-np.inf))


def itself(problem: Problem) -> Problem:
    """The problem with the engine itself in place of its tables."""
    return problem._replace(chunks=problem.chunks._replace(table=None))


def fitted(problem: Problem, fit: Fit) -> Model:
    """The model whose fit is continued from `fit` until it has converged."""
    return Model(problem, *optimise(problem, fit))
