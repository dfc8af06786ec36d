"""Uncertainty of the fitted constants, by a covariance that does not assume independent noise."""

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from simgap.diagnosis.config import AT_BOUND, LEAST_SHARE, Z95
from simgap.diagnosis.hypotheses.space import Hypothesis, unit_of
from simgap.diagnosis.hypotheses.support import Window
from simgap.diagnosis.inference.evidence.null_distribution import blocks
from simgap.diagnosis.inference.evidence.scan import edges_ci95, scores
from simgap.diagnosis.inference.fitting.model import without
from simgap.diagnosis.likelihood.derivatives import constant_columns
from simgap.diagnosis.likelihood.directions import directions, spans
from simgap.diagnosis.likelihood.problem import Fit, Group, Problem, evaluate, trials, value_of
from simgap.diagnosis.likelihood.segments import rows_of
from simgap.diagnosis.likelihood.student_t import weights
from simgap.effects.effect import Constant


class Spread(NamedTuple):
    """Standard deviations of phi and of the effects' constants (internal), in the order of the fit's groups.

    seen: which parameters the recordings depend on at all, that is, have a derivative other than zero.
    """

    phi: Float[np.ndarray, " p"]
    constants: Float[np.ndarray, " k"]
    seen: Bool[np.ndarray, " p"]


def spread(
    problem: Problem, fit: Fit, nuisance: Float[np.ndarray, "M n s"], starts: Int[np.ndarray, " B"] | None = None
) -> Spread:
    """The larger standard deviations of the likelihood's own and the sandwich covariance over blocks of rows
    [White 1982].

    Blocks begin at `starts`; by default they are short.
    """
    columns = np.concatenate([nuisance, constant_columns(problem, fit.v, fit.groups)])
    _, precision = directions(problem, fit.groups)
    w = weights(fit.e, fit.noise).astype(np.float64)
    weighted = columns * w
    flat = columns.reshape(len(columns), -1).astype(np.float64)
    hessian = weighted.reshape(len(columns), -1) @ flat.T + np.diag(precision)
    scale = np.sqrt(np.diag(hessian))
    inverse = np.linalg.pinv(hessian / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    rows = (weighted * fit.e).sum(-1)
    starts = blocks(np.asarray(problem.chunks.counts)) if starts is None else starts
    score = np.add.reduceat(rows, starts, axis=1)
    sandwich = inverse @ (score @ score.T) @ inverse
    sd = np.sqrt(np.maximum(np.maximum(np.diag(inverse), np.diag(sandwich)), 0.0))
    p, sizes = len(fit.v.phi), np.array([group.scale for group in fit.groups])
    seen = np.abs(columns[:p]).max((1, 2), initial=0.0) > 0
    return Spread(sd[:p] * spans(problem), sd[len(nuisance) :] * sizes, seen)


def at_bound(problem: Problem, fit: Fit) -> dict[str, float]:
    """Parameters that the fit puts at an end of their range, or nearly, each with that end."""
    return {
        p.name: end
        for p, value in zip(problem.augmented.simulator.parameters, map(float, fit.v.phi), strict=True)
        for end in (p.low, p.high)
        if abs(value - end) <= AT_BOUND * (p.high - p.low) and p.low < p.high
    }


def differs_from_zero(problem: Problem, fit: Fit, hypothesis: Hypothesis, sd: Spread, deviations: float = Z95) -> bool:
    """Whether an amplitude of the effect is at least `deviations` standard deviations from zero, and all constants are
    plausible: no larger than credible, and not at a bound (bounds lie beyond what a robot does)."""
    differs = False
    for constant, group in zip(hypothesis.effect.constants, hypothesis.groups, strict=True):
        value = abs(value_of(fit.v, group))
        if not _in_range(problem, hypothesis, constant, value) or _at_end(problem, fit, group):
            return False
        differs |= not constant.shapes and value > deviations * sd.constants[fit.groups.index(group)]
    return bool(differs)


def means_another(problem: Problem, fit: Fit, hypothesis: Hypothesis) -> bool:
    """Whether a shape of the fitted law lies where another law is meant, or none."""
    shapes = [(c, g) for c, g in zip(hypothesis.effect.constants, hypothesis.groups, strict=True) if c.shapes]
    return not all(_in_range(problem, hypothesis, c, abs(value_of(fit.v, g))) for c, g in shapes)


def _in_range(problem: Problem, hypothesis: Hypothesis, constant: Constant, value: float) -> bool:
    """Whether the size of a constant is plausible at every site that shares it."""
    least = min(constant.least(site, problem.scales) for site in hypothesis.sites)
    return least <= value <= min(constant.credible(site, problem.scales) for site in hypothesis.sites)


def _at_end(problem: Problem, fit: Fit, group: Group) -> bool:
    """Whether a constant is at a bound other than zero; in a support, whether its sum with theta is."""
    entry = group.entries[0]
    value = value_of(fit.v, group) + (float(fit.v.theta[entry]) if group.support else 0.0)
    ends = np.array([bound[entry] for bound in problem.augmented.bounds])
    return bool(np.any(np.isfinite(ends) & (ends != 0) & (np.abs(value - ends) <= AT_BOUND * np.abs(ends))))


def constants(problem: Problem, fit: Fit, hypothesis: Hypothesis, sd: Spread, gain: float) -> list[dict]:
    """The physical constants of an effect that gains `gain` nats, with units and 95 % intervals.

    Intervals cover chance, and values that cost no more than `LEAST_SHARE` of the gain. So small a loss may only
    reflect misfit between law and robot, which more rows do not remove. For an effect that changed since a baseline,
    values and intervals are those of the change: 0.07 s where a delay of 0.03 s became 0.10 s.
    """
    described, deviations = [], deviations_for(gain)
    for constant, group in zip(hypothesis.effect.constants, hypothesis.groups, strict=True):
        # In a support both act: the constant that holds everywhere, and the one added there.
        base = float(fit.v.theta[group.entries[0]]) if group.support else 0.0
        c = value_of(fit.v, group)
        width = deviations * float(sd.constants[fit.groups.index(group)])
        physical = partial(_physical, problem, hypothesis.sites[0], constant, group)
        at_zero = physical(0.0)
        # A limit has no change, since it is infinite where there is none.
        offset = at_zero - physical(base) if hypothesis.twin and not constant.shapes and np.isfinite(at_zero) else 0.0
        value, *ends = (physical(base + x) + offset for x in (c, c - width, c + width))
        unit = unit_of(problem.augmented, hypothesis, constant)
        described.append({"name": constant.name, "value": value, "unit": unit, "ci95": sorted(ends)})
    return described


def determined(problem: Problem, fit: Fit, hypothesis: Hypothesis, sd: Spread, gain: float) -> bool:
    """Whether the recordings determine the constants of an effect that gains `gain` nats: no interval is empty or
    covers the whole range, and no constant is at a bound other than zero."""
    low, high = problem.augmented.bounds
    for group in hypothesis.groups:
        c = value_of(fit.v, group)
        width = deviations_for(gain) * float(sd.constants[fit.groups.index(group)])
        undetermined = c - width <= low[group.entries[0]] and c + width >= high[group.entries[0]]
        if undetermined or not width > 0 or _at_end(problem, fit, group):
            return False
    return True


def edges(problem: Problem, fit: Fit, hypothesis: Hypothesis, window: Window) -> list[dict]:
    """Beginning and end [s] of an effect that acts during a window of one session, with 95 % intervals."""
    everywhere = problem._replace(chunks=problem.chunks._replace(gate=np.ones_like(problem.chunks.gate)))
    bare = evaluate(problem, without(fit, hypothesis.groups).v, (), fit.noise)
    evidence = scores(fit, bare.e, trials(everywhere, [fit.v])[0])
    intervals = edges_ci95(rows_of(problem.chunks), window, *evidence)
    return [
        {"name": name, "value": value, "unit": "s", "ci95": list(interval)}
        for name, value, interval in zip(("from", "to"), (window.from_s, window.to_s), intervals, strict=True)
    ]


def deviations_for(gain: float) -> float:
    """Half-width of an interval in standard deviations, for an effect that gains `gain` nats."""
    return float(np.sqrt(Z95**2 + 2 * LEAST_SHARE * max(gain, 0.0)))


def _physical(problem: Problem, site: int, constant: Constant, group: Group, internal: float) -> float:
    """The physical value of an internal one, which is clipped to its bounds."""
    low, high = (float(bound[group.entries[0]]) for bound in problem.augmented.bounds)
    return float(constant.physical(float(np.clip(internal, low, high)), site, problem.scales))
