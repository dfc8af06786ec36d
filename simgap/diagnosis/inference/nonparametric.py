"""A law without a name: bodies are pushed in a way that depends on their motion, their place, or their commands.

Every function of the dictionary along every axis is a hypothesis. That is ten thousand, which are not run but made up
of echoes. As in `screen`, what the model can absorb is projected out and the best is compared with the best by chance,
and held-out sessions must agree; then the next is looked for, given those before.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import LEVEL
from simgap.diagnosis.hypotheses.library import Function, dictionary, quantities, values
from simgap.diagnosis.inference.heldout import agrees, by_row
from simgap.diagnosis.inference.impulse_response import Echo, direction, echoes, evidence, hear
from simgap.diagnosis.inference.model import Model, Reporter, absorbing
from simgap.diagnosis.inference.null_distribution import Weighed, blocks, by_chance, weigh
from simgap.diagnosis.inference.score_test import basis_of
from simgap.diagnosis.likelihood.derivatives import nuisance_columns
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, side_by_side
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.diagnosis.likelihood.student_t import log_density, weights

MOST_TERMS = 4
AT_ONCE = 64
"""Functions that are weighed at once."""
REQUIRED = -np.log(LEVEL)
"""Nats that held-out sessions must gain: by chance they gain as many with probability `LEVEL` at most, since a
likelihood ratio has a mean of one. What the best of ten thousand gains by chance on fitted sessions is not known well
enough."""
RANK = 1e-6
"""Of directions that are fitted together: what lies below this share of the greatest is rounding."""


class Term(NamedTuple):
    """Part of a law: the axis along which it pushes, what it depends on, and its gain when it was found [nats]."""

    axis: str
    depends_on: tuple[str, ...]
    gain: float


class Law(NamedTuple):
    """The terms, none where there is no law, and the decorrelated innovations with it, fitted and held out."""

    terms: tuple[Term, ...]
    fitted: Float[np.ndarray, "n s"]
    heldout: Float[np.ndarray, "m s"]

    def nats(self, fit: Fit) -> Float[np.ndarray, " s"]:
        """What the law gains over a fit without it, in every decorrelated output."""
        return (log_density(self.fitted, fit.noise) - log_density(fit.e, fit.noise)).sum(0)


class _Rows(NamedTuple):
    """Recordings prepared: innovations, derivatives of all that is free in the model, echoes along every axis, and the
    quantities that a law may depend on."""

    problem: Problem
    e: Float[np.ndarray, "n s"]
    absorbing: Float[np.ndarray, "M n s"]
    echoes: dict[str, Echo]
    z: Float[np.ndarray, "C T-1 q"]

    def directions(self, axis: str, functions: Sequence[Function]) -> Float[np.ndarray, "f n s"]:
        """Changes of the innovations by pushes along an axis."""
        return direction(self.problem, self.echoes[axis], [f.of(self.z) for f in functions])


_Part = tuple[Term, Function]


def no_law(model: Model, unseen: Chunks) -> Law:
    """Nothing beside the model; `unseen` are the held-out rows."""
    return Law((), model.fit.e, _on(model, unseen).e)


def nonparametric_law(model: Model, unseen: Chunks, rng: np.random.Generator, report: Reporter) -> Law:
    """A law beside the model's effects, if there is one."""
    rows = _rows(model)
    functions = dictionary(quantities(model.problem.augmented.layout), rows.z[np.asarray(model.problem.chunks.counts)])
    found, chosen, held = no_law(model, unseen), [], None
    pushable = rows.echoes and functions  # a simulator may declare no body
    while pushable and len(chosen) < MOST_TERMS:
        part, p_value, required = _best(rows, model.fit, functions, chosen, rng)
        report(f"a law without a name: p = {p_value:.4f}")
        if p_value > LEVEL:
            break
        held = held or _rows(_there(model, unseen))
        chosen.append(part)
        better = _with(rows, held, model.fit, chosen)
        line = f"{part[0].axis} pushed by {' and '.join(part[0].depends_on)}"
        gained, heldout = (_by_row(model.fit, *pair) for pair in zip(found[1:], better[1:], strict=True))
        if not agrees(gained, float(heldout.sum()) - REQUIRED, model.problem.chunks, required):
            report(f"{line} does not hold on sessions that took no part")
            break
        report(f"{line} ({gained.sum():+.1f} nats)")
        found = better
    return found


def _on(model: Model, chunks: Chunks) -> Fit:
    """The fit on other rows; nothing is fitted anew."""
    fit = model.fit
    return evaluate(model.problem._replace(chunks=chunks), fit.v, fit.groups, fit.noise)


def _there(model: Model, chunks: Chunks) -> Model:
    """The model on other rows, with the derivatives that it has there."""
    problem = model.problem._replace(chunks=chunks)
    return Model(problem, _on(model, chunks), nuisance_columns(problem, model.fit.v))


def _rows(model: Model) -> _Rows:
    problem, fit, _ = model
    return _Rows(problem, fit.e, absorbing(model), echoes(problem, fit.v), values(problem, fit.v))


def _by_row(fit: Fit, *innovations: Float[np.ndarray, "n s"]) -> Float[np.ndarray, " n"]:
    """Nats gained from the first to the second."""
    return by_row(*(fit._replace(e=e) for e in innovations))


def _best(
    rows: _Rows, fit: Fit, functions: Sequence[Function], chosen: Sequence[_Part], rng: np.random.Generator
) -> tuple[_Part, float, float]:
    """The best further term, the chance that noise gives as good a one, and the gain [nats] that is required."""
    root = np.sqrt(weights(fit.e, fit.noise)).astype(np.float32)
    columns = [*rows.absorbing, *(rows.directions(term.axis, [f])[0] for term, f in chosen)]
    basis = basis_of(np.stack([(c * root).reshape(-1) for c in columns]))
    residual = (rows.e * root).reshape(-1)
    residual = residual - basis @ (basis.T @ residual)
    starts = blocks(np.full(rows.z.shape[:2], True))

    def weighed(axis: str) -> list[Weighed]:
        heard = hear(rows.problem, rows.echoes[axis], root, residual, basis)
        parts = (pushes[first : first + AT_ONCE] for first in range(0, len(pushes), AT_ONCE))
        return [weigh(evidence(heard, part), starts) for part in parts]

    axes, pushes = list(rows.echoes), [f.of(rows.z) for f in functions]
    every = [w for some in side_by_side(weighed, axes) for w in some]
    together = Weighed(*(np.concatenate(a) for a in zip(*every, strict=True)))
    p_value, threshold = by_chance(together, LEVEL, rng)
    best = int(together.statistic.argmax())
    axis, function = axes[best // len(functions)], functions[best % len(functions)]
    return (Term(axis, function.depends_on, float(together.gain[best])), function), p_value, threshold / 2


def _with(rows: _Rows, held: _Rows, fit: Fit, chosen: Sequence[_Part]) -> Law:
    """The law of these terms, fitted together with all that is free in the model."""
    columns = [
        np.concatenate([r.absorbing, *(r.directions(term.axis, [f]) for term, f in chosen)]) for r in (rows, held)
    ]
    root = np.sqrt(weights(fit.e, fit.noise)).astype(np.float32)
    a = (columns[0] * root).reshape(len(columns[0]), -1)
    length = np.maximum(np.linalg.norm(a, axis=1, keepdims=True), 1e-30)
    gram, moment = (a / length) @ (a / length).T, (a / length) @ (rows.e * root).reshape(-1)
    solved = np.linalg.lstsq(gram.astype(np.float64), moment, rcond=RANK)[0] / length[:, 0]
    better = (r.e - np.tensordot(solved, c, 1) for r, c in zip((rows, held), columns, strict=True))
    return Law(tuple(term for term, _ in chosen), *better)
