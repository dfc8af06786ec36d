"""A nonparametric law: pushes on bodies that depend on their motion, their position, or their commands.

Every function of the dictionary along every axis is a hypothesis. These ten thousand are not simulated but composed of
impulse responses. As in `screen`, what the model can absorb is projected out, the best is compared with the null
distribution of the maximum, and held-out sessions must agree. Then the next term is sought, given the previous ones.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import LEVEL, MOST_EFFECTS
from simgap.diagnosis.hypotheses.library import Function, dictionary, quantities, values
from simgap.diagnosis.inference.evidence.null_distribution import Weighed, blocks, by_chance, weigh
from simgap.diagnosis.inference.evidence.score_test import basis_of
from simgap.diagnosis.inference.fitting.heldout import agrees, by_row
from simgap.diagnosis.inference.fitting.model import Model, Reporter, absorbing
from simgap.diagnosis.inference.misfit.impulse_response import Echo, direction, echoes, evidence, hear
from simgap.diagnosis.likelihood.derivatives import nuisance_columns
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.diagnosis.likelihood.student_t import log_density, weights
from simgap.threads import side_by_side

AT_ONCE = 64
"""Functions that are tested per batch."""
REQUIRED = -np.log(LEVEL)
"""Minimum gain [nats] on held-out sessions. Chance reaches it with probability `LEVEL` at most, since a likelihood
ratio has a mean of one. What the best of ten thousand gains by chance on fitted sessions is not known well enough."""
RANK = 1e-6
"""Smallest singular value that counts in a joint fit, as a share of the largest; smaller ones are rounding."""


class Term(NamedTuple):
    """Part of a law: the axis along which it pushes, what it depends on, and its gain [nats] when it was selected."""

    axis: str
    depends_on: tuple[str, ...]
    gain: float


class Law(NamedTuple):
    """The terms (none: no law), and the decorrelated innovations with them, on fitted and on held-out sessions."""

    terms: tuple[Term, ...]
    fitted: Float[np.ndarray, "n s"]
    heldout: Float[np.ndarray, "m s"]

    def nats(self, fit: Fit) -> Float[np.ndarray, " s"]:
        """Gain [nats] over a fit without the law, per decorrelated output."""
        return (log_density(self.fitted, fit.noise) - log_density(fit.e, fit.noise)).sum(0)


class _Rows(NamedTuple):
    """Prepared recordings: innovations, derivatives by all free constants of the model, impulse responses along every
    axis, and the quantities that a law may depend on."""

    problem: Problem
    e: Float[np.ndarray, "n s"]
    absorbing: Float[np.ndarray, "M n s"]
    echoes: dict[str, Echo]
    z: Float[np.ndarray, "C T-1 q"]

    def directions(self, axis: str, functions: Sequence[Function]) -> Float[np.ndarray, "f n s"]:
        """Changes of the innovations caused by pushes along an axis."""
        return direction(self.problem, self.echoes[axis], [f.of(self.z) for f in functions])


_Part = tuple[Term, Function]


def no_law(model: Model, unseen: Chunks) -> Law:
    """The empty law; `unseen` are the held-out rows."""
    return Law((), model.fit.e, _evaluated_on(model, unseen).e)


def nonparametric_law(model: Model, unseen: Chunks, rng: np.random.Generator, report: Reporter) -> Law:
    """A law in addition to the model's effects; empty if there is none."""
    rows = _prepared(model)
    functions = dictionary(quantities(model.problem.augmented.layout), rows.z[np.asarray(model.problem.chunks.counts)])
    law, chosen, heldout_rows = no_law(model, unseen), [], None
    pushable = rows.echoes and functions  # a simulator may declare no body
    while pushable and len(chosen) < MOST_EFFECTS:
        part, p_value, required = _best_term(rows, model.fit, functions, chosen, rng)
        report(f"nonparametric law: p = {p_value:.4f}")
        if p_value > LEVEL:
            break
        heldout_rows = heldout_rows or _prepared(_model_on(model, unseen))
        chosen.append(part)
        extended = _fit_terms(rows, heldout_rows, model.fit, chosen)
        line = f"push on {part[0].axis} that depends on {' and '.join(part[0].depends_on)}"
        gained, heldout_gain = (_by_row(model.fit, *pair) for pair in zip(law[1:], extended[1:], strict=True))
        if not agrees(gained, float(heldout_gain.sum()) - REQUIRED, model.problem.chunks, required):
            report(f"{line}: does not hold on held-out sessions")
            break
        report(f"{line}: accepted ({gained.sum():+.1f} nats)")
        law = extended
    return law


def _evaluated_on(model: Model, chunks: Chunks) -> Fit:
    """The fit evaluated on other rows, without refitting."""
    fit = model.fit
    return evaluate(model.problem._replace(chunks=chunks), fit.v, fit.groups, fit.noise)


def _model_on(model: Model, chunks: Chunks) -> Model:
    """The model on other rows, with its derivatives there."""
    problem = model.problem._replace(chunks=chunks)
    return Model(problem, _evaluated_on(model, chunks), nuisance_columns(problem, model.fit.v))


def _prepared(model: Model) -> _Rows:
    problem, fit, _ = model
    return _Rows(problem, fit.e, absorbing(model), echoes(problem, fit.v), values(problem, fit.v))


def _by_row(fit: Fit, *innovations: Float[np.ndarray, "n s"]) -> Float[np.ndarray, " n"]:
    """Gain [nats] of every row from the first innovations to the second."""
    return by_row(*(fit._replace(e=e) for e in innovations))


def _best_term(
    rows: _Rows, fit: Fit, functions: Sequence[Function], chosen: Sequence[_Part], rng: np.random.Generator
) -> tuple[_Part, float, float]:
    """The best further term, its p-value, and the required gain [nats]."""
    root = np.sqrt(weights(fit.e, fit.noise)).astype(np.float32)
    columns = [*rows.absorbing, *(rows.directions(term.axis, [f])[0] for term, f in chosen)]
    basis = basis_of(np.stack([(c * root).reshape(-1) for c in columns]))
    residual = (rows.e * root).reshape(-1)
    residual = residual - basis @ (basis.T @ residual)
    starts = blocks(np.full(rows.z.shape[:2], True))

    def weighed(axis: str) -> list[Weighed]:
        responses = hear(rows.problem, rows.echoes[axis], root, residual, basis)
        parts = (pushes[first : first + AT_ONCE] for first in range(0, len(pushes), AT_ONCE))
        return [weigh(evidence(responses, part), starts) for part in parts]

    axes, pushes = list(rows.echoes), [f.of(rows.z) for f in functions]
    batches = [w for of_axis in side_by_side(weighed, axes) for w in of_axis]
    combined = Weighed(*(np.concatenate(a) for a in zip(*batches, strict=True)))
    chance, best = by_chance(combined, rng), int(combined.statistic.argmax())
    axis, function = axes[best // len(functions)], functions[best % len(functions)]
    term = Term(axis, function.depends_on, float(combined.gain[best])), function
    return term, chance.p_value(combined.statistic[best]), chance.critical(LEVEL) / 2


def _fit_terms(rows: _Rows, heldout: _Rows, fit: Fit, chosen: Sequence[_Part]) -> Law:
    """The law of these terms, fitted jointly with all free constants of the model."""
    columns = [
        np.concatenate([r.absorbing, *(r.directions(term.axis, [f]) for term, f in chosen)]) for r in (rows, heldout)
    ]
    root = np.sqrt(weights(fit.e, fit.noise)).astype(np.float32)
    a = (columns[0] * root).reshape(len(columns[0]), -1)
    length = np.maximum(np.linalg.norm(a, axis=1, keepdims=True), 1e-30)
    gram, moment = (a / length) @ (a / length).T, (a / length) @ (rows.e * root).reshape(-1)
    solved = np.linalg.lstsq(gram.astype(np.float64), moment, rcond=RANK)[0] / length[:, 0]
    innovations = (r.e - np.tensordot(solved, c, 1) for r, c in zip((rows, heldout), columns, strict=True))
    return Law(tuple(term for term, _ in chosen), *innovations)
