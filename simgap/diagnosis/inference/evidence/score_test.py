"""Score test: which of many hypotheses deserve a fit, and whether the best of them gains more than noise does.

Every hypothesis is a direction in the innovations: the change d that its effect makes at a starting value. What phi,
filter gain and the model's constants can absorb of d is projected out. The rest predicts how much the effect could
gain. A bootstrap of the model's scores gives the null distribution of the best gain of all directions.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.inference.evidence.null_distribution import NOTHING, Evidence, Weighed, blocks, by_chance, weigh
from simgap.diagnosis.inference.evidence.screening import Screened, Screening
from simgap.diagnosis.likelihood.problem import Fit, Problem, trials, with_value
from simgap.diagnosis.likelihood.student_t import weights
from simgap.diagnosis.likelihood.variables import Variables
from simgap.threads import side_by_side

PART = 32
"""Directions kept in memory at once."""
PROMISING = 5
"""Hypotheses that are tested at further values."""
CLOSER = 2
"""Rounds of further values."""
BETWEEN = 3
"""Further values between two that were tested."""
MULTIPLES = (3, 5, 7, 9)
"""Multiples of a staircase's true step that also fit: one in three (five ...) of the true steps coincides."""
DEPENDENT = 1e-6
"""Eigenvalues of a Gram matrix below this share of the greatest are rounding errors."""


class _Direction(NamedTuple):
    """One constant of a hypothesis at its start, with the other amplitudes at zero."""

    hypothesis: Hypothesis
    values: tuple[float, ...]
    constant: int


class _Tested(NamedTuple):
    """A direction with the score and information of every row. unmoved: see `Screened`."""

    direction: _Direction
    score: Float[np.ndarray, " n"]
    power: Float[np.ndarray, " n"]
    unmoved: float


def vary(v: Variables, hypothesis: Hypothesis, constants: Sequence[float]) -> Variables:
    """v with the constants of the hypothesis set."""
    for group, value in zip(hypothesis.groups, constants, strict=True):
        v = with_value(v, group, value)
    return v


def _directions(hypotheses: Sequence[Hypothesis]) -> list[_Direction]:
    """Every amplitude of every hypothesis at all of its starts; shapes keep their starting values."""
    directions = []
    for hypothesis in hypotheses:
        shapes = [c.shapes for c in hypothesis.effect.constants]
        for start in hypothesis.starts:
            for k, shape in enumerate(shapes):
                if not shape:
                    values = tuple(v if j == k or shapes[j] else 0.0 for j, v in enumerate(start))
                    directions.append(_Direction(hypothesis, values, k))
    return directions


def screen(
    problem: Problem,
    fit: Fit,
    basis: Float[np.ndarray, "m r"],
    hypotheses: Sequence[Hypothesis],
    rng: np.random.Generator,
) -> Screening:
    """Test all hypotheses against the fitted model. basis: orthonormal columns of what the model absorbs."""
    w = weights(fit.e, fit.noise).astype(np.float32)
    root = np.sqrt(w).reshape(-1)
    # At the optimum the residual is orthogonal to what the model absorbs, but for rounding in float32.
    residual = fit.e.reshape(-1) * root
    residual = (residual - basis @ (basis.T @ residual)).reshape(fit.e.shape)
    low, _ = problem.augmented.bounds
    starts = blocks(np.asarray(problem.chunks.counts))

    def batch(part: Sequence[_Direction]) -> list[_Tested]:
        """Scores and information of directions, without those whose start diverges."""
        vs = [vary(fit.v, hypothesis, values) for hypothesis, values, _ in part]
        with np.errstate(over="ignore", invalid="ignore"):
            change = trials(problem, vs) - fit.e
            d = change.reshape(len(part), -1) * root
            unmoved = 0.5 * np.einsum("pn,pn->p", d, d)
            d = _beyond_twin(problem, fit, part, d, root)
            d = (d - (d @ basis) @ basis.T).reshape(len(part), *fit.e.shape)
            score, power = np.einsum("pns,ns->pn", d, -residual), np.einsum("pns,pns->pn", d, d)
            finite = np.isfinite(power.sum(1))
        return [_Tested(s, score[i], power[i], float(unmoved[i])) for i, s in enumerate(part) if finite[i]]

    def tested(directions: Sequence[_Direction]) -> list[_Tested]:
        parts = [directions[first : first + PART] for first in range(0, len(directions), PART)]
        return [t for part in side_by_side(batch, parts) for t in part]

    def summed(results: Sequence[_Tested]) -> tuple[Evidence, Weighed, list[Screened]]:
        shape = len(results), len(fit.e)
        score, power = np.array([t.score for t in results]), np.array([t.power for t in results])
        two_sided = [low[d.hypothesis.groups[d.constant].entries[0]] < 0 for d, *_ in results]
        evidence = Evidence(score.reshape(shape), power.reshape(shape), np.array(two_sided, bool))
        weighed = weigh(evidence, starts)
        return evidence, weighed, [_screened(t, weighed, i) for i, t in enumerate(results)]

    results = tested(_directions(hypotheses))
    for _ in range(CLOSER):
        # The direction of a strong effect differs from that near zero, and that of a limit from that of a slightly
        # wider one. What a direction misses of the effect counts as noise.
        *_, found = summed(results)
        results += tested([d for starts in _most_promising(found) for d in closer(starts, hypotheses)])
    evidence, weighed, found = summed(results)
    best_first = np.argsort(-weighed.gain, kind="stable")
    evidence = Evidence(*(a[best_first] for a in evidence))
    tested_names = {s.hypothesis.name for s in found}
    untested = tuple(c.name for c in hypotheses if c.name not in tested_names)
    return Screening([found[i] for i in best_first], evidence, by_chance(weighed, rng), untested)


def basis_of(rows: Float[np.ndarray, "M m"]) -> Float[np.ndarray, "m r"]:
    """Orthonormal columns that span the rows, by their Gram matrix: for few long rows in a tenth of QR's time."""
    length = np.linalg.norm(rows.astype(np.float64), axis=1, keepdims=True)
    rows = (rows / np.where(length > 0, length, 1.0)).astype(np.float32)
    values, vectors = np.linalg.eigh((rows @ rows.T).astype(np.float64))
    kept = values > DEPENDENT * values[-1]
    return rows.T @ (vectors[:, kept] / np.sqrt(values[kept])).astype(np.float32)


def _most_promising(found: Sequence[Screened]) -> list[list[Screened]]:
    """All tests of the hypotheses' constants with the greatest gains, best first; then as many of jagged laws.

    Near its maximum, but not on it, a jagged law has little of its gain.
    """
    tested: dict[tuple[str, int, bool, int], list[Screened]] = {}
    for s in sorted(found, key=lambda s: -s.gain):
        hypothesis = s.hypothesis
        key = (hypothesis.name, hypothesis.groups[0].support, bool(hypothesis.twin), s.constant)
        tested.setdefault(key, []).append(s)
    smooth, jagged = ([t for t in tested.values() if t[0].hypothesis.effect.jagged == j] for j in (False, True))
    return [*smooth[:PROMISING], *jagged[:PROMISING]]


def closer(tested: Sequence[Screened], hypotheses: Sequence[Hypothesis]) -> list[_Direction]:
    """Further directions of a hypothesis: where its best start led to, or between that start and its neighbours.

    A jagged law has narrow maxima. So it is also tested at some of its sites alone, whose own starts may miss the
    maximum, and at odd fractions of its best value, because a staircase also fits with odd multiples of its true step.
    """
    best, k = tested[0], tested[0].constant
    values = sorted({s.start[k] for s in tested})
    # There is also a single value if the model diverges at all others.
    if in_proportion(best.hypothesis, k) or len(values) == 1:
        return [_Direction(best.hypothesis, best.start, k)]
    i = values.index(best.start[k])
    ratios = [later / value for value, later in pairwise(values)]
    ratios = [ratios[0], *ratios, ratios[-1]]
    shares = np.arange(1, BETWEEN + 1) / (BETWEEN + 1)
    # Between starts of opposite signs lies zero, where the law is silent: only the start itself is looked at there.
    steps = [ratio if ratio > 0 else 1.0 for ratio in (1 / ratios[i], ratios[i + 1])]
    between = [values[i] * step**share for step in steps for share in shares]
    laws = [best.hypothesis]
    if best.hypothesis.effect.jagged:
        laws += [c for c in hypotheses if _part(c, best.hypothesis)]
        between += [best.start[k] / n for n in (1, *MULTIPLES)]
    return [_Direction(c, (*best.start[:k], float(v), *best.start[k + 1 :]), k) for c in laws for v in between]


def _part(hypothesis: Hypothesis, whole: Hypothesis) -> bool:
    """Whether a hypothesis is that of the same law at some of the sites, in the same support."""
    same_law = hypothesis.effect is whole.effect and hypothesis.groups[0].support == whole.groups[0].support
    return same_law and bool(hypothesis.twin) == bool(whole.twin) and set(hypothesis.sites) < set(whole.sites)


def in_proportion(hypothesis: Hypothesis, k: int) -> bool:
    """Whether a law is proportional to its constant, or nearly: then one start is enough."""
    return len({start[k] for start in hypothesis.starts}) == 1


def _beyond_twin(
    problem: Problem,
    fit: Fit,
    directions: Sequence[_Direction],
    d: np.ndarray,
    root: np.ndarray,
) -> Float[np.ndarray, "k m"]:
    """Directions minus their projection on the twin, the same effect acting everywhere, where there is one."""
    with_twin = [i for i, (hypothesis, _, _) in enumerate(directions) if hypothesis.twin]
    if not with_twin:
        return d
    twins = [vary(fit.v, h._replace(groups=h.twin), values) for h, values, _ in (directions[i] for i in with_twin)]
    along_twin = np.zeros_like(d)
    along_twin[with_twin] = (trials(problem, twins) - fit.e).reshape(len(with_twin), -1) * root
    power = (along_twin * along_twin).sum(1, keepdims=True)
    return d - along_twin * (d * along_twin).sum(1, keepdims=True) / np.maximum(power, NOTHING)


def _screened(tested: _Tested, weighed: Weighed, i: int) -> Screened:
    hypothesis, values, k = tested.direction
    share = 1.0
    # A law that is proportional to its constant can start at the best amplitude.
    if in_proportion(hypothesis, k) and weighed.gain[i] > 0:
        share = float(np.clip(weighed.amplitude[i], -3, 3))
    start = tuple(v * share if j == k else v for j, v in enumerate(values))
    gain, statistic, power = float(weighed.gain[i]), float(weighed.statistic[i]), 0.5 * float(tested.power.sum())
    return Screened(hypothesis, start, k, gain, statistic, power, tested.unmoved, values[k])
