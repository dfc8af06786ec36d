"""Fits of an engine, whose tables hold only near the point where they were made: they are renewed as a fit moves."""

from collections.abc import Sequence

import numpy as np

from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.fitting.model import SETTLED, Trial
from simgap.diagnosis.likelihood.directions import bounds_of
from simgap.diagnosis.likelihood.linearised import tabulated
from simgap.diagnosis.likelihood.problem import NEAR, Fit, Problem, evaluate, value_of, with_value
from simgap.diagnosis.likelihood.variables import Variables
from simgap.engines import Table, is_engine

SIZES = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors on an effect's fitted constants that are tried on an engine itself."""
CLOSE = 0.1
"""Share by which a fit may move before an engine is differentiated again. Until then only its next states are renewed:
those say where the fit ends, the derivatives only how fast it gets there."""
RENEWALS = 4
"""How often tables are made for one fit, at most."""


def relinearised(problem: Problem, fit: Fit, reach: float = NEAR) -> tuple[Problem, Fit]:
    """Continue the fit, with new tables where it leads, until it has converged. Without an engine nothing changes.

    reach: how far the parameters may move with one table. The tables are for this fit alone (see `for_all`).
    """
    if not is_engine(problem.augmented.simulator):
        return problem, fit
    differentiated = None
    for _ in range(RENEWALS):
        if differentiated is not None and _close(differentiated, fit.v):
            problem = _renewed(problem, fit.v, reach, [fit], problem.chunks.table)
        else:
            differentiated, problem = fit.v, _renewed(problem, fit.v, reach, [fit])
        initial = evaluate(problem, fit.v, fit.groups)
        if not np.isfinite(initial.loglik):
            return problem, initial
        fit, _ = optimise(problem, initial)
        if fit.loglik - initial.loglik < SETTLED:
            break
    return problem, fit


def for_all(problem: Problem, v: Variables) -> Problem:
    """The problem with an engine's tables at v for all hypotheses, not only for those of one fit."""
    return _renewed(problem, v, problem.reach, ())


def _renewed(
    problem: Problem, v: Variables, reach: float, fits: Sequence[Fit], derivatives: Table | None = None
) -> Problem:
    if not is_engine(problem.augmented.simulator):
        return problem
    chunks = tabulated(problem, v, problem.chunks, fits, derivatives)
    return problem._replace(chunks=chunks, near=np.asarray(v.phi), reach=reach)


def _close(at: Variables, v: Variables) -> bool:
    """Whether parameters (logarithms) and effects' constants differ by less than a share of `CLOSE`."""
    constants = [(at.theta, v.theta), (at.delta, v.delta)]
    same = all(bool(np.all(np.abs(a - b) <= CLOSE * np.maximum(np.abs(a), np.abs(b)))) for a, b in constants)
    return same and bool(np.all(np.abs(at.phi - v.phi) <= CLOSE))


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
