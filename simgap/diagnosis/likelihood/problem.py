"""Recordings, the simulator to explain them, and the log-likelihood of its innovations at given constants.

Innovations of different outputs are correlated (a position integrates its velocity). A fixed matrix decorrelates them,
so that log-likelihoods of outputs add up. Each output then has its own Student's t noise.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.likelihood.filter import alone, filtered
from simgap.diagnosis.likelihood.segments import Chunks, counted
from simgap.diagnosis.likelihood.student_t import NORMAL_MAD, Noise, fit_noise, log_density
from simgap.diagnosis.likelihood.variables import Variables
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales
from simgap.threads import side_by_side

NEAR = 0.5
"""How far parameters (logarithms) may move from where an engine was tabulated: a factor of 1.6. Without this bound,
tables and engine differed by thousands of nats."""
TRUSTED = 0.5
"""Initial diagonal of K: the share of an innovation by which the state estimate is corrected."""
FEW = 2
"""With at most this many effects (one accepted, one tested), the program of single rows omits the laws of others."""


class Problem(NamedTuple):
    """Recordings and the simulator to explain them; `whiten` decorrelates the innovations of the o observed outputs.

    ranges_hold: parameters stay in their declared ranges; False lets a fit show which other ranges would explain the
    recordings. near: parameters at which an engine was tabulated; the tables are invalid far from them. reach: how far
    from there parameters may move; 0 fixes them.
    """

    augmented: Augmented
    scales: Scales
    chunks: Chunks
    whiten: Float[np.ndarray, "o o"]
    ranges_hold: bool = True
    near: Float[np.ndarray, " p"] | None = None
    reach: float = NEAR


class Group(NamedTuple):
    """One free constant.

    entries: those of theta that share it. scale: size at which it is searched; its unit in fits and derivatives.
    support: where it acts: everywhere (0), or where support s is open (s from 1).
    """

    entries: tuple[int, ...]
    scale: float
    support: int = 0


class Fit(NamedTuple):
    """A model with fitted constants; e: decorrelated innovations of the scored rows."""

    v: Variables
    groups: tuple[Group, ...]
    e: Float[np.ndarray, "n s"]
    noise: Noise
    loglik: float


def evaluate(problem: Problem, v: Variables, groups: tuple[Group, ...], noise: Noise | None = None) -> Fit:
    """Innovations, noise (fitted unless given) and log-likelihood at v."""
    e = trials(problem, [v])[0]
    if not np.isfinite(e).all():
        return Fit(v, groups, e, noise or Noise(np.ones(e.shape[1]), np.ones(e.shape[1])), -np.inf)
    noise = noise or fit_noise(e)
    return Fit(v, groups, e, noise, float(log_density(e, noise).sum()))


def start(problem: Problem) -> Variables:
    """Initial variables: nominal parameters, equal weights of prediction and measurement, no effect.

    Observed states correct an unobserved one of their axis with the gain that an alpha-beta filter has for the rate
    [Kalata 1984]; others, at first, not.
    """
    layout = problem.augmented.layout
    follows = [not (layout.observed[i] or layout.apart[i]) and bool(layout.observed[j]) for i, j in layout.akin]
    sizes = (len(layout.schema.state), len(problem.augmented.slots))
    gain, zero = (np.zeros(n, np.float32) for n in sizes)
    phi = problem.augmented.nominal
    return Variables(
        phi if problem.near is None else np.clip(phi, problem.near - problem.reach, problem.near + problem.reach),
        gain + TRUSTED,
        np.where(follows, TRUSTED**2 / (2 - TRUSTED), 0.0).astype(np.float32),
        zero,
        np.zeros((problem.chunks.gate.shape[1], len(zero)), np.float32),
    )


def whitening(e: Float[np.ndarray, "n s"]) -> Float[np.ndarray, "s s"]:
    """W such that W e is uncorrelated and of unit scale, from the covariance after clipping outliers.

    Outputs that are always zero keep their scale. Returns the identity if an innovation is not finite.
    """
    if not np.isfinite(e).all():
        return np.eye(e.shape[1])
    size = np.abs(e.astype(np.float64))
    scale = np.zeros(e.shape[1]) if not len(e) else np.median(size, axis=0) * NORMAL_MAD
    # An output that is mostly constant has a median of zero: use its largest innovation.
    scale = np.where(scale > 0, scale, size.max(0, initial=0.0))
    scale = np.where(scale > 0, scale, 1.0)
    z = np.clip(e / scale, -3, 3)
    z = z - z.sum(0) / max(len(z), 1)
    covariance = z.T @ z / max(len(z) - 1, 1) + 1e-4 * np.eye(e.shape[1])
    return np.linalg.inv(np.linalg.cholesky(covariance)) / scale


def value_of(v: Variables, group: Group) -> float:
    """Internal value of a group's constant."""
    base = v.theta if group.support == 0 else v.delta[group.support - 1]
    return float(base[group.entries[0]])


def with_value(v: Variables, group: Group, value: float) -> Variables:
    """v with a group's constant set."""
    if group.support == 0:
        return v._replace(theta=replaced(v.theta, group.entries, value))
    delta = np.array(v.delta, np.float32)
    delta[group.support - 1, list(group.entries)] = value
    return v._replace(delta=delta)


def raw_innovations(problem: Problem, v: Variables) -> Float[np.ndarray, "C t o"]:
    """Innovations in the observed outputs' own units; zero in rows that are not scored."""
    return np.where(np.asarray(problem.chunks.counts)[..., None], _innovations(problem, v), np.float32(0))


def _innovations(problem: Problem, v: Variables) -> Float[np.ndarray, "C t o"]:
    """The same, with whatever the filter gives in rows that are not scored."""
    return np.asarray(filtered(problem.augmented, problem.scales, v, problem.chunks, v.phi).innovations)


def estimates(problem: Problem, v: Variables) -> Float[np.ndarray, "C t s"]:
    """State estimates at the beginning of the steps, including rows that are not scored."""
    return np.asarray(filtered(problem.augmented, problem.scales, v, problem.chunks, v.phi).states)


def trials(problem: Problem, vs: Sequence[Variables]) -> Float[np.ndarray, "M n s"]:
    """Decorrelated innovations for several values of the variables.

    Not vectorised: each value then pays for its own laws only, and vectorising would gain nothing.
    """
    return np.stack(side_by_side(lambda v: decorrelate(problem, _innovations(problem, v)), vs))


def row_trials(problem: Problem, v: Variables, thetas: Sequence[Float[np.ndarray, " P"]]) -> Float[np.ndarray, "M n s"]:
    """Decorrelated innovations of every row, with only its own step taken with other constants of the effects."""
    lean = problem.augmented.lean(FEW, v.theta, v.delta, *thetas)
    raw = lambda theta: alone(lean, problem.scales, v, theta, problem.chunks)  # noqa: E731
    return np.stack(side_by_side(lambda theta: decorrelate(problem, raw(theta)), thetas))


def decorrelate(problem: Problem, raw: Any) -> Float[np.ndarray, "... n s"]:
    """Decorrelated innovations of the scored rows."""
    with np.errstate(over="ignore", invalid="ignore"):  # a trial may diverge; it is then rejected
        return counted(problem.chunks, raw) @ problem.whiten.T.astype(np.float32)


def replaced(values: Float[np.ndarray, " P"], entries: Sequence[int], by: Any) -> Float[np.ndarray, " P"]:
    """A copy with some entries replaced."""
    values = np.array(values, np.float32)
    values[list(entries)] = by
    return values
