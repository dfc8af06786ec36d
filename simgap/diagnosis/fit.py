"""Maximum likelihood of the innovations: Gauss-Newton with weights that Student's t noise gives.

The innovations' outputs are correlated (a position integrates its velocity): they are decorrelated by a fixed matrix
first, so that nats add up; then each has a Student's t noise of its own.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import lsq_linear
from scipy.special import gammaln

from simgap.diagnosis.innovations import Chunks, Variables, alone, innovations_of, tangents
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales
from simgap.types import DivergenceError

DOFS = np.array([2.5, 3, 4, 5, 7, 10, 20, 60])
FROM_AFAR, FROM_NEAR = 6, 3
"""Steps to the scale of the first of these, and from each one's to the next one's."""
BATCH = 16
"""Directions whose derivatives are computed side by side: one number, for each is compiled anew."""
THREADS = 2
"""Batches, or hypotheses, that are worked on at once; each computation keeps to one core."""
NARROW = 1e-9
"""Added to bounds, which must not touch [root nats]."""
STEP = 0.02
"""Of a constant's size and scale: the step of its central differences."""
PHI_STEP = 1e-3
"""Of a parameter's range, and of the gain: the step where the derivative itself is not finite."""
FURTHEST = 1e15
"""Decorrelated innovations beyond this count as this: their squares stay finite in 32 bits."""
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
TRUST = (0.0, 1.0)
"""Bounds of K's diagonal: the share of an innovation that a measured output is trusted with."""
CROSS = 3.0
"""Bound of K's other entries, in units of the time step."""
PRIOR_PRECISION = 1.0
"""Of the simulator's parameters, in units of their ranges: a range is one standard deviation, hence hardly a prior."""


class Problem(NamedTuple):
    """Recordings and the simulator to explain them; `whiten` decorrelates the innovations' outputs.

    ranges_hold: parameters stay in their declared ranges. Without, it is asked what other ranges would explain.
    """

    augmented: Augmented
    scales: Scales
    chunks: Chunks
    whiten: Float[np.ndarray, "s s"]
    ranges_hold: bool = True


class Group(NamedTuple):
    """One free constant: the entries of theta that share it, the size it is looked for at (its unit in fits and
    derivatives), and whether it acts where gated only."""

    entries: tuple[int, ...]
    scale: float
    gated: bool = False


class Noise(NamedTuple):
    """Student's t of each decorrelated output."""

    scale: Float[np.ndarray, " s"]
    dof: Float[np.ndarray, " s"]


class Fit(NamedTuple):
    """A model with its constants fitted; e: decorrelated innovations of the rows that count."""

    v: Variables
    groups: tuple[Group, ...]
    e: Float[np.ndarray, "n s"]
    noise: Noise
    loglik: float


def log_density(e: Float[np.ndarray, "n s"], noise: Noise) -> Float[np.ndarray, "n s"]:
    """ln t(e), elementwise."""
    d = noise.dof
    constant = gammaln((d + 1) / 2) - gammaln(d / 2) - 0.5 * np.log(d * np.pi) - np.log(noise.scale)
    return constant - (d + 1) / 2 * np.log1p((e / noise.scale) ** 2 / d)


def weights(e: Float[np.ndarray, "n s"], noise: Noise) -> Float[np.ndarray, "n s"]:
    """w with d ln t / de = -w e: what an innovation counts for."""
    return (noise.dof + 1) / (noise.dof * noise.scale**2 + e**2)


def fit_noise(e: Float[np.ndarray, "n s"]) -> Noise:
    """Scale for every dof of `DOFS`, each from where the one before ended, and the dof of greatest likelihood."""
    if not len(e):
        return Noise(np.ones(e.shape[1]), np.full(e.shape[1], DOFS[-1]))
    squared = np.maximum(np.clip(e.T.astype(np.float32), -FURTHEST, FURTHEST) ** 2, np.float32(1e-30))
    variance, found = np.maximum(np.median(squared, axis=-1) * 2, 1e-18), []
    for dof in DOFS:
        variance, density = _fit_scale(squared, variance, float(dof), FROM_NEAR if found else FROM_AFAR)
        found.append((variance, density))
    best = np.array([density for _, density in found]).argmax(0)
    return Noise(np.sqrt(np.array([v for v, _ in found])[best, np.arange(e.shape[1])]), DOFS[best])


def _fit_scale(
    squared: Float[np.ndarray, "s n"], variance: Float[np.ndarray, " s"], dof: float, steps: int
) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, " s"]]:
    """Squared scale of t noise with so many degrees of freedom, and the mean log-density with it.

    Parameter-expanded EM [Liu, Rubin & Wu 1998]: v <- mean(w x^2) / mean(w) with w = 1 / (dof + x^2 / v), where
    mean(w x^2) = v (1 - dof mean(w)).
    """
    work = np.empty_like(squared)
    for _ in range(steps):
        np.divide(squared, variance[:, None].astype(np.float32), out=work)
        work += np.float32(dof)
        np.reciprocal(work, out=work)
        mean = work.mean(-1, dtype=np.float64)
        variance = variance * np.maximum(1 / mean - dof, 0.0) + 1e-18
    np.divide(squared, (dof * variance[:, None]).astype(np.float32), out=work)
    tails = np.log1p(work, out=work).mean(-1, dtype=np.float64)
    density = gammaln((dof + 1) / 2) - gammaln(dof / 2) - 0.5 * np.log(dof * np.pi * variance)
    return variance, density - (dof + 1) / 2 * tails


def counted(chunks: Chunks, e: np.ndarray) -> np.ndarray:
    """The rows that count, in order: [..., n, s]."""
    return np.asarray(e)[..., np.asarray(chunks.counts), :]


def evaluate(problem: Problem, v: Variables, groups: tuple[Group, ...], noise: Noise | None = None) -> Fit:
    """Innovations, noise (fitted unless given) and log-likelihood at v."""
    e = trials(problem, [v])[0]
    if not np.isfinite(e).all():
        return Fit(v, groups, e, noise or Noise(np.ones(e.shape[1]), np.ones(e.shape[1])), -np.inf)
    noise = noise or fit_noise(e)
    return Fit(v, groups, e, noise, float(log_density(e, noise).sum()))


def start(problem: Problem) -> Variables:
    """Nominal parameters, equal trust in prediction and measurement, no effect."""
    layout = problem.augmented.layout
    sizes = (len(layout.schema.state), len(layout.akin), len(problem.augmented.slots))
    gain, cross, zero = (np.zeros(n, np.float32) for n in sizes)
    return Variables(problem.augmented.nominal, gain + 0.5, cross, zero, zero)


def whitening(e: Float[np.ndarray, "n s"]) -> Float[np.ndarray, "s s"]:
    """W with W e uncorrelated and of unit scale, by the covariance of what is left when outliers are clipped.

    Outputs that are always zero keep their scale. The identity where an innovation is not finite.
    """
    if not np.isfinite(e).all():
        return np.eye(e.shape[1])
    size = np.abs(e.astype(np.float64))
    scale = np.zeros(e.shape[1]) if not len(e) else np.median(size, axis=0) * 1.4826
    # Of an output that mostly stays exactly where it is, what it does elsewhere.
    scale = np.where(scale > 0, scale, size.max(0, initial=0.0))
    scale = np.where(scale > 0, scale, 1.0)
    z = np.clip(e / scale, -3, 3)
    z = z - z.sum(0) / max(len(z), 1)
    covariance = z.T @ z / max(len(z) - 1, 1) + 1e-4 * np.eye(e.shape[1])
    return np.linalg.inv(np.linalg.cholesky(covariance)) / scale


def directions(problem: Problem, groups: Sequence[Group]) -> tuple[Variables, Float[np.ndarray, " M"]]:
    """Unit directions of all that is free (phi by ranges, K, constants by scales), and the precision of their prior."""
    p, s, size = len(problem.augmented.simulator.parameters), len(problem.whiten), len(problem.augmented.slots)
    c = len(problem.augmented.layout.akin)
    m = p + s + c + len(groups)
    phi, gain, cross, theta, gated = (np.zeros((m, n), np.float32) for n in (p, s, c, size, size))
    phi[:p] = np.diag(spans(problem))
    gain[p : p + s] = np.eye(s)
    cross[p + s : p + s + c] = np.eye(c)
    for k, group in enumerate(groups):
        (gated if group.gated else theta)[p + s + c + k, list(group.entries)] = group.scale
    precision = [(p, PRIOR_PRECISION), (s, 0.1), (c, 1.0), (len(groups), 1e-8)]
    return Variables(phi, gain, cross, theta, gated), np.concatenate([np.full(n, each) for n, each in precision])


def spans(problem: Problem) -> Float[np.ndarray, " p"]:
    """Widths of the parameters' ranges: their units in fits and derivatives."""
    return np.array([q.high - q.low or 1.0 for q in problem.augmented.simulator.parameters])


def nuisance_columns(problem: Problem, v: Variables) -> Float[np.ndarray, "M n s"]:
    """Derivatives of the decorrelated innovations by phi (in ranges) and K.

    As differences where a derivative is not finite, as that of a root at zero; zero where these are not either.
    """
    free, _ = directions(problem, ())
    count = len(free.phi)

    def batch(first: int) -> np.ndarray:
        # The last batch is filled up by repetition.
        index = np.minimum(np.arange(first, first + BATCH), count - 1)
        along = (a[index] for a in (free.phi, free.gain, free.cross))
        raw = tangents(problem.augmented, problem.scales, v, *along, problem.chunks)
        return _decorrelated(problem, raw)[: count - first]

    columns = np.concatenate(side_by_side(batch, range(0, count, BATCH)))
    odd = np.flatnonzero(~_bounded(columns))
    return _without_odd(columns, odd, _differences(problem, v, odd)) if len(odd) else columns


def _bounded(columns: Float[np.ndarray, "M n s"]) -> Bool[np.ndarray, " M"]:
    """Whether columns are finite, and their squares as well."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.array([np.isfinite(np.vdot(c, c)) for c in columns], bool)


def _without_odd(columns: np.ndarray, odd: np.ndarray, others: np.ndarray) -> Float[np.ndarray, "M n s"]:
    """Columns with some replaced by others where those are bounded, and by zero where not."""
    columns[odd] = np.where(_bounded(others)[:, None, None], others, 0.0)
    return columns


def _differences(problem: Problem, v: Variables, which: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k n s"]:
    """Derivatives along some directions of phi and K as differences, within bounds."""
    size = len(directions(problem, ())[1])
    plus, minus = ([_moved(problem, v, (), d * np.eye(size)[k]) for k in which] for d in (PHI_STEP, -PHI_STEP))
    down, up = _room(problem, v, ())
    width = np.minimum(up, PHI_STEP) - np.maximum(down, -PHI_STEP)
    return _slopes(trials(problem, [*plus, *minus]), width[which])


def _slopes(e: Float[np.ndarray, "2k n s"], width: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k n s"]:
    """Differences of the first and the second half, over their distances; zero where that is zero."""
    k, wide = len(width), np.where(width > 0, width, np.inf).astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        return (e[:k] - e[k:]) / wide[:, None, None]


def raw_innovations(problem: Problem, v: Variables) -> Float[np.ndarray, "C t s"]:
    """Innovations in the outputs' own units, zero in rows that do not count."""
    return np.asarray(innovations_of(problem.augmented, problem.scales, v, problem.chunks))


def trials(problem: Problem, vs: Sequence[Variables]) -> Float[np.ndarray, "M n s"]:
    """Decorrelated innovations of several values of the variables.

    One by one: what a value's laws cost is paid for that value alone, and nothing is gained side by side.
    """
    return np.stack(side_by_side(lambda v: _decorrelated(problem, raw_innovations(problem, v)), vs))


def row_trials(problem: Problem, v: Variables, thetas: Sequence[Float[np.ndarray, " P"]]) -> Float[np.ndarray, "M n s"]:
    """Decorrelated innovations of every row, had its step alone been taken with other constants of the effects."""
    one = lambda theta: alone(problem.augmented, problem.scales, v, theta, problem.chunks)  # noqa: E731
    return np.stack(side_by_side(lambda theta: _decorrelated(problem, one(theta)), thetas))


def _decorrelated(problem: Problem, raw: Any) -> Float[np.ndarray, "... n s"]:
    with np.errstate(over="ignore", invalid="ignore"):  # a trial may explode; it is then not taken
        return counted(problem.chunks, raw) @ problem.whiten.T.astype(np.float32)


def side_by_side(function: Callable, items: Iterable) -> list:
    """The function of every item, in order, computed on `THREADS` threads."""
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(function, items))


def constant_columns(problem: Problem, v: Variables, groups: Sequence[Group]) -> Float[np.ndarray, "k n s"]:
    """Derivatives by constants (in scales) as central differences, wide enough to see over kinks; one-sided at a bound,
    and zero where the simulator leaves the finite numbers."""
    if not groups:
        return np.zeros((0, int(np.asarray(problem.chunks.counts).sum()), len(problem.whiten)), np.float32)
    plus, minus, width = [], [], []
    for group in groups:
        entries = list(group.entries)
        base = v.gated if group.gated else v.theta
        value = float(base[entries[0]])
        h = STEP * (abs(value) + group.scale)
        low, high = _bounds(problem, v, group)
        ends = np.array([min(value + h, high), max(value - h, low)], np.float32)
        for target, to in zip((plus, minus), ends, strict=True):
            changed = replaced(base, entries, to)
            target.append(v._replace(gated=changed) if group.gated else v._replace(theta=changed))
        width.append(float(ends[0] - ends[1]) / group.scale)
    columns = _slopes(trials(problem, [*plus, *minus]), np.array(width))
    odd = np.flatnonzero(~_bounded(columns))
    return _without_odd(columns, odd, np.zeros_like(columns[odd])) if len(odd) else columns


def _bounds(problem: Problem, v: Variables, group: Group) -> tuple[float, float]:
    """Between which a constant makes sense: where it is gated, together with what acts everywhere."""
    entries = list(group.entries)
    low, high = (bound[entries] for bound in problem.augmented.bounds)
    if not group.gated:
        return float(low.max()), float(high.min())
    here, value = np.asarray(v.theta)[entries], float(v.gated[entries[0]])
    return min(float((low - here).max()), value), max(float((high - here).min()), value)


def _ranges(problem: Problem) -> tuple[Any, Any]:
    """Least and greatest values that the parameters may have."""
    return problem.augmented.ranges if problem.ranges_hold else (-np.inf, np.inf)


def _room(
    problem: Problem, v: Variables, groups: Sequence[Group]
) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, " M"]]:
    """How far each free direction can be gone from v, down and up."""
    (low, high), units = _ranges(problem), spans(problem)
    down = [(low - v.phi) / units, TRUST[0] - v.gain, -CROSS - v.cross]
    up = [(high - v.phi) / units, TRUST[1] - v.gain, CROSS - v.cross]
    for group in groups:
        least, most = (-np.inf, np.inf) if group.gated else _bounds(problem, v, group)
        value = v.theta[group.entries[0]]
        down.append(np.array([(least - value) / group.scale]))
        up.append(np.array([(most - value) / group.scale]))
    return np.minimum(np.concatenate(down), 0.0), np.maximum(np.concatenate(up), 0.0)


def _moved(problem: Problem, v: Variables, groups: Sequence[Group], delta: np.ndarray) -> Variables:
    """v + delta along the free directions, kept within the bounds where it is rounded."""
    free, _ = directions(problem, groups)
    moved = Variables(*(a + delta.astype(np.float32) @ b for a, b in zip(v, free, strict=True)))
    low, high = problem.augmented.bounds
    own = [i for g in groups if not g.gated for i in g.entries]
    theta = replaced(moved.theta, own, np.clip(moved.theta[own], low[own], high[own]))
    phi = np.clip(moved.phi, *_ranges(problem))
    return Variables(phi, np.clip(moved.gain, *TRUST), np.clip(moved.cross, -CROSS, CROSS), theta, moved.gated)


def replaced(values: Float[np.ndarray, " P"], entries: Sequence[int], by: Any) -> Float[np.ndarray, " P"]:
    """A copy with some entries replaced."""
    values = np.array(values, np.float32)
    values[list(entries)] = by
    return values


def _prior_offset(problem: Problem, v: Variables, groups: Sequence[Group]) -> np.ndarray:
    """Where v stands from the prior's centre, along the free directions."""
    parameters = problem.augmented.simulator.parameters
    middle = np.array([(p.low + p.high) / 2 for p in parameters])
    return np.concatenate(
        [
            (np.asarray(v.phi) - middle) / spans(problem),
            np.asarray(v.gain) - 0.5,
            np.asarray(v.cross),
            np.zeros(len(groups)),
        ]
    )


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
    offset = _prior_offset(problem, fit.v, fit.groups)
    upper = np.hstack([np.tensordot(level, held.gram, 1), by_held[:k].T])
    curvature = np.vstack([upper, np.hstack([by_held[:k], by_renewed[:k]])]).astype(np.float64)
    hessian = curvature + np.diag(precision)
    gradient = np.concatenate([by_held[k], by_renewed[k]]).astype(np.float64) + precision * offset
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
        return fit
    # What the recordings do not depend on, or not by a finite derivative, stays where it is.
    down, up = (np.where(np.diag(curvature) > 0, room, 0.0) for room in _room(problem, fit.v, fit.groups))
    delta = lowest(hessian, gradient, down, up)

    def value(e: np.ndarray, v: Variables) -> float:
        if not np.isfinite(e).all():
            return -np.inf
        away = _prior_offset(problem, v, fit.groups)
        return float(log_density(e, fit.noise).sum()) - 0.5 * float(precision @ away**2)

    slope, bend = -float(delta @ gradient), float(delta @ hessian @ delta)
    now, best = value(fit.e, fit.v), None
    for share in SHARES:
        v = _moved(problem, fit.v, fit.groups, share * delta)
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
