"""Whiteness: how far a model's innovations can be predicted from earlier ones.

A complete model has white innovations, whatever the noise: none predicts the next. What can be predicted is unnamed
physics, whatever its cause. It is the reference for what the named effects explain.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from simgap.diagnosis.config import PREDICTABLE, REQUIRED_OF_NOISE, TOUCHED
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.diagnosis.likelihood.segments import rows_of
from simgap.diagnosis.likelihood.student_t import log_density
from simgap.layout import Layout

LAGS = 8
"""Rows of past innovations that predict the next."""
RIDGE = 5.0
FOLDS = 4
DRAWS = 20
"""Draws of innovations with random signs, which are unpredictable: they give the gain by chance."""


class Whiteness(NamedTuple):
    """Predictability of every decorrelated output, cross-validated; zero where it may be chance.

    nats: gain by predicting. share: predicted share of the squared innovations. predicted: predicted part of every
    innovation.
    """

    nats: Float[np.ndarray, " s"]
    share: Float[np.ndarray, " s"]
    predicted: Float[np.ndarray, "n s"]


def whiteness(problem: Problem, fit: Fit) -> Whiteness:
    """Autoregression of every output's innovations on their own past, cross-validated over runs of rows."""
    y = np.clip(fit.e / fit.noise.scale, -3, 3)
    session = rows_of(problem.chunks).session
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (DRAWS, len(y), 1))
    chance = max(_gained(drawn, _predicted(drawn, session))[0].max() for drawn in signs * y)
    predicted = _predicted(y, session)
    nats, share = _gained(y, predicted)
    sure = (share > PREDICTABLE) & (nats > max(chance, 0.0) + REQUIRED_OF_NOISE)
    return Whiteness(*(np.where(sure, a, 0.0) for a in (nats, share, predicted * fit.noise.scale)))


def by_row(fit: Fit, found: Whiteness) -> Float[np.ndarray, "n s"]:
    """Each row's part of the log-likelihood gained by predicting [nats]."""
    y = np.clip(fit.e / fit.noise.scale, -3, 3)
    residual = y - found.predicted / fit.noise.scale
    before, after = (np.maximum((a**2).mean(0), 1e-12) for a in (y, residual))
    return 0.5 * (y**2 / before - residual**2 / after + np.log(before / after))


def _gained(y: Float[np.ndarray, "n s"], predicted: Float[np.ndarray, "n s"]) -> tuple[np.ndarray, np.ndarray]:
    """Gain in log-likelihood [nats], and predicted share of the squares, per column."""
    share = 1 - ((y - predicted) ** 2).sum(0) / np.maximum((y**2).sum(0), 1e-12)
    return -0.5 * len(y) * np.log(np.clip(1 - share, 1e-6, None)), share


def _predicted(y: Float[np.ndarray, "n s"], session: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n s"]:
    """Ridge regression of each column on its own `LAGS` past values in the session, fitted on the other folds."""
    past = np.zeros((LAGS, *y.shape), y.dtype)
    for k in range(1, min(LAGS, len(y) - 1) + 1):
        past[k - 1, k:] = np.where((session[k:] == session[:-k])[:, None], y[:-k], 0.0)
    fold = np.arange(len(y)) * FOLDS // len(y)
    predicted = np.zeros_like(y)
    for j in range(y.shape[1]):
        x = past[:, :, j].T
        for f in range(FOLDS):
            fitted = fold != f
            gram = x[fitted].T @ x[fitted] + RIDGE * np.eye(LAGS)
            predicted[~fitted, j] = x[~fitted] @ np.linalg.solve(gram, x[fitted].T @ y[fitted, j])
    return predicted


def touched(layout: Layout, fit: Fit, without: Fit) -> Bool[np.ndarray, " s"]:
    """The outputs that an effect improves; `without` is the fit without it. A position and its velocity are one."""
    gained = log_density(fit.e, fit.noise).sum(0) - log_density(without.e, without.noise).sum(0)
    improved = gained > TOUCHED * max(float(gained.sum()), 0.0)
    velocity = layout.integrates[layout.observed]
    (moved,) = np.nonzero((velocity >= 0) & (velocity < len(velocity)))  # some velocities are not outputs
    either = improved[moved] | improved[velocity[moved]]
    improved[moved], improved[velocity[moved]] = either, either
    return improved


def named_share(layout: Layout, fit: Fit, without: Fit, nameless: Float[np.ndarray, " s"]) -> float:
    """Share that an effect explains of what there is to explain in the outputs that it improves.

    `without` is the fit without the effect; `nameless` is the unnamed gain [nats] that remains with it in every output.
    """
    by_output = log_density(fit.e, fit.noise).sum(0) - log_density(without.e, without.noise).sum(0)
    gained = max(float(by_output.sum()), 0.0)
    return gained / max(gained + float(nameless[touched(layout, fit, without)].sum()), 1e-9)
