"""Which of many hypotheses deserve a fit, and whether the best of them is more than the best of noise.

Every hypothesis is a direction in the innovations: the change d that its effect makes at a starting value. What phi,
gain and the constants at hand can absorb of d is projected out; the rest says how much an effect of this kind could
gain, and a bootstrap of the current model's scores says how much the best of all directions gains by chance.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import LEVEL
from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.inference.null_distribution import NOTHING, Evidence, Weighed, blocks, by_chance, weigh
from simgap.diagnosis.likelihood.filter import Variables
from simgap.diagnosis.likelihood.problem import Fit, Problem, side_by_side, trials, with_value
from simgap.diagnosis.likelihood.student_t import weights

PART = 8
"""Directions that are kept in memory at once."""
PROMISING = 5
"""Hypotheses that are looked at more closely,"""
CLOSER = 2
"""so many times,"""
BETWEEN = 3
"""with so many values between two that were tested."""
MULTIPLES = (3, 5, 7, 9)
"""Of the true steps of a staircase, at which it looks right as well: every so many of them coincide."""
DEPENDENT = 1e-6
"""Share of the greatest, below which a direction of what the model can absorb is rounding."""


class Screened(NamedTuple):
    """A hypothesis at a start: gain expected [nats], and its test statistic (chi-squared with one degree of freedom).

    constant: the one tested; tested: the value it was tested at. power: nats that an effect at that value would gain,
    so what the recordings could have shown.
    """

    hypothesis: Hypothesis
    start: tuple[float, ...]
    constant: int
    gain: float
    statistic: float
    power: float
    tested: float

    @property
    def as_it_stands(self) -> float:
        """Gain expected at the start itself [nats], not with the best amplitude along its direction."""
        return 2 * np.sqrt(self.gain * self.power) - self.power


class _Direction(NamedTuple):
    """One constant of a hypothesis at its start, the other amplitudes zero."""

    hypothesis: Hypothesis
    values: tuple[float, ...]
    constant: int


_Tested = tuple[_Direction, Float[np.ndarray, " n"], Float[np.ndarray, " n"]]
"""A direction with its score and information, row by row."""


class Screening(NamedTuple):
    """All hypotheses, best first, what speaks for each, and the chance that noise alone gives as good a best one.

    threshold: of the statistic, at `level`. untested: names of the hypotheses with which the simulator leaves the
    finite numbers, wherever they start.
    """

    found: list[Screened]
    evidence: Evidence
    p_value: float
    threshold: float
    untested: tuple[str, ...]


def vary(v: Variables, hypothesis: Hypothesis, constants: Sequence[float]) -> Variables:
    """v with the hypothesis's constants set."""
    for group, value in zip(hypothesis.groups, constants, strict=True):
        v = with_value(v, group, value)
    return v


def _directions(hypotheses: Sequence[Hypothesis]) -> list[_Direction]:
    """Every constant of every hypothesis at all of its starts, shapes at their start as well."""
    found = []
    for hypothesis in hypotheses:
        shapes = [c.shapes for c in hypothesis.effect.constants]
        for start in hypothesis.starts:
            for k, shape in enumerate(shapes):
                if not shape:
                    values = tuple(v if j == k or shapes[j] else 0.0 for j, v in enumerate(start))
                    found.append(_Direction(hypothesis, values, k))
    return found


def screen(
    problem: Problem,
    fit: Fit,
    basis: Float[np.ndarray, "m r"],
    hypotheses: Sequence[Hypothesis],
    rng: np.random.Generator,
) -> Screening:
    """Test all hypotheses against the fitted model, at `LEVEL`; `absorbed` as `beyond` gives it."""
    w = weights(fit.e, fit.noise).astype(np.float32)
    root = np.sqrt(w).reshape(-1)
    # At the optimum the residual has no part in what the model can absorb; float32 leaves a trace.
    residual = fit.e.reshape(-1) * root
    residual = residual - basis @ (basis.T @ residual)
    low, _ = problem.augmented.bounds
    starts = blocks(np.asarray(problem.chunks.counts))

    def batch(some: Sequence[_Direction]) -> list[_Tested]:
        """Scores and powers of directions, but of those whose start explodes."""
        vs = [vary(fit.v, hypothesis, values) for hypothesis, values, _ in some]
        with np.errstate(over="ignore", invalid="ignore"):
            change = trials(problem, vs) - fit.e
            d = change.reshape(len(some), -1) * root
            d = _beyond_twin(problem, fit, some, d, root)
            d = d - (d @ basis) @ basis.T
            score, power = (a.reshape(len(some), *fit.e.shape).sum(2) for a in (-d * residual, d * d))
            finite = np.isfinite(power.sum(1))
        return [(s, score[i], power[i]) for i, s in enumerate(some) if finite[i]]

    def tested(directions: Sequence[_Direction]) -> list[_Tested]:
        parts = [directions[first : first + PART] for first in range(0, len(directions), PART)]
        return [t for part in side_by_side(batch, parts) for t in part]

    def summed(results: Sequence[_Tested]) -> tuple[Evidence, Weighed, list[Screened]]:
        score, power = (np.array([t[i] for t in results]).reshape(len(results), len(fit.e)) for i in (1, 2))
        two_sided = [low[d.hypothesis.groups[d.constant].entries[0]] < 0 for d, *_ in results]
        evidence = Evidence(score, power, np.array(two_sided, bool))
        weighed = weigh(evidence, starts)
        return evidence, weighed, [_screened(d, evidence, weighed, i) for i, (d, *_) in enumerate(results)]

    results = tested(_directions(hypotheses))
    for _ in range(CLOSER):
        # Where it stands a strong effect is another direction than near nil, and so is a limit than one a little
        # further out: what a direction misses of it counts as noise.
        *_, found = summed(results)
        results += tested([d for starts in _most_promising(found) for d in closer(starts, hypotheses)])
    evidence, weighed, found = summed(results)
    best_first = np.argsort(-weighed.gain, kind="stable")
    evidence = Evidence(*(a[best_first] for a in evidence))
    known = {s.hypothesis.name for s in found}
    untested = tuple(c.name for c in hypotheses if c.name not in known)
    return Screening([found[i] for i in best_first], evidence, *by_chance(weighed, LEVEL, rng), untested)


def basis_of(rows: Float[np.ndarray, "M m"]) -> Float[np.ndarray, "m r"]:
    """Orthonormal columns that span the rows, from the rows' products: of few long rows, in a tenth of QR's time."""
    length = np.linalg.norm(rows.astype(np.float64), axis=1, keepdims=True)
    rows = (rows / np.where(length > 0, length, 1.0)).astype(np.float32)
    values, vectors = np.linalg.eigh((rows @ rows.T).astype(np.float64))
    kept = values > DEPENDENT * values[-1]
    return rows.T @ (vectors[:, kept] / np.sqrt(values[kept])).astype(np.float32)


def _most_promising(found: Sequence[Screened]) -> list[list[Screened]]:
    """What was tested of some hypotheses' constants, those of greatest gain, best first; of jagged laws as many, for
    what is near such a law's summit but not on it has little of its gain."""
    tested: dict[tuple[str, int, bool, int], list[Screened]] = {}
    for s in sorted(found, key=lambda s: -s.gain):
        hypothesis = s.hypothesis
        key = (hypothesis.name, hypothesis.groups[0].support, bool(hypothesis.twin), s.constant)
        tested.setdefault(key, []).append(s)
    smooth, jagged = ([t for t in tested.values() if t[0].hypothesis.effect.jagged == j] for j in (False, True))
    return [*smooth[:PROMISING], *jagged[:PROMISING]]


def closer(tested: Sequence[Screened], hypotheses: Sequence[Hypothesis]) -> list[_Direction]:
    """A hypothesis where its best start led to, or between that start and those beside it.

    Of a jagged law, whose summits are narrow: also at some of its sites alone, whose own starts may lie beside the
    summit; and where the steps of a staircase that looks right are an odd multiple of the true ones.
    """
    best, k = tested[0], tested[0].constant
    values = sorted({s.start[k] for s in tested})
    # One value is left as well where the model explodes at all others.
    if in_proportion(best.hypothesis, k) or len(values) == 1:
        return [_Direction(best.hypothesis, best.start, k)]
    i = values.index(best.start[k])
    ratios = [later / value for value, later in pairwise(values)]
    ratios = [ratios[0], *ratios, ratios[-1]]
    shares = np.arange(1, BETWEEN + 1) / (BETWEEN + 1)
    between = [values[i] * ratio**share for ratio in (1 / ratios[i], ratios[i + 1]) for share in shares]
    there = [best.hypothesis]
    if best.hypothesis.effect.jagged:
        there += [c for c in hypotheses if _part(c, best.hypothesis)]
        between += [best.start[k] / n for n in (1, *MULTIPLES)]
    return [_Direction(c, (*best.start[:k], float(v), *best.start[k + 1 :]), k) for c in there for v in between]


def _part(hypothesis: Hypothesis, of: Hypothesis) -> bool:
    """Whether a hypothesis is that of the same law at some of its sites."""
    alike = hypothesis.effect is of.effect and hypothesis.groups[0].support == of.groups[0].support
    return alike and bool(hypothesis.twin) == bool(of.twin) and set(hypothesis.sites) < set(of.sites)


def in_proportion(hypothesis: Hypothesis, k: int) -> bool:
    """Whether a law is in proportion to its constant, or nearly: one start of it is enough then."""
    return len({start[k] for start in hypothesis.starts}) == 1


def _beyond_twin(
    problem: Problem,
    fit: Fit,
    some: Sequence[_Direction],
    d: np.ndarray,
    root: np.ndarray,
) -> Float[np.ndarray, "k m"]:
    """Directions less their part along the same effect acting everywhere, for hypotheses that have such a twin."""
    have = [i for i, (hypothesis, _, _) in enumerate(some) if hypothesis.twin]
    if not have:
        return d
    twins = [vary(fit.v, c._replace(groups=c.twin), values) for c, values, _ in (some[i] for i in have)]
    t = np.zeros_like(d)
    t[have] = (trials(problem, twins) - fit.e).reshape(len(have), -1) * root
    power = (t * t).sum(1, keepdims=True)
    return d - t * (d * t).sum(1, keepdims=True) / np.maximum(power, NOTHING)


def _screened(direction: _Direction, evidence: Evidence, weighed: Weighed, i: int) -> Screened:
    hypothesis, values, k = direction
    share = 1.0
    # A law in proportion to its constant can start where the data would have it.
    if in_proportion(hypothesis, k) and weighed.gain[i] > 0:
        share = float(np.clip(weighed.amplitude[i], -3, 3))
    start = tuple(v * share if j == k else v for j, v in enumerate(values))
    power = 0.5 * float(evidence.power[i].sum())
    return Screened(hypothesis, start, k, float(weighed.gain[i]), float(weighed.statistic[i]), power, values[k])
