"""Innovations of an engine by its own rows, without JAX and without tables.

A hidden state behind stiff stops is too far from linear for tables, and each rival engine would be compiled anew. The
filter is that of `filter`, for joints, whose gain needs no rotation.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from simgap.diagnosis.likelihood.problem import Problem, decorrelate
from simgap.diagnosis.likelihood.sent import sent_of, terms_in_rows
from simgap.diagnosis.likelihood.variables import Variables
from simgap.engines import Engine, no_effort


class Driven(NamedTuple):
    """What drives a filter in the N segments that are scored: their first states, measurements, commands that act in
    the parts of each row, and terms of the engine. scored: which segments these are."""

    first: Float[np.ndarray, "N s"]
    measured: Float[np.ndarray, "N T o"]
    command: Float[np.ndarray, "N T-1 parts u"]
    terms: Float[np.ndarray, "N T-1 k"]
    scored: Bool[np.ndarray, " C"]


def driven(problem: Problem, v: Variables) -> Driven:
    """What drives the problem's engine with the command paths and the terms in v.

    Other laws (pushes, what sensors do to a state) are left out.
    """
    augmented, chunks = problem.augmented, problem.chunks
    scored = np.asarray(np.asarray(chunks.counts).any(1))
    terms = np.asarray(terms_in_rows(augmented, v, chunks), float)
    command, state = np.asarray(sent_of(augmented, v, chunks), float), np.asarray(chunks.state, float)
    outputs = len(augmented.layout.schema.outputs)
    return Driven(state[scored, 0], state[scored][..., :outputs], command[scored], terms[scored], scored)


def innovations(
    problem: Problem,
    engine: Engine,
    given: Driven,
    phi: Float[np.ndarray, " p"],
    gain: Float[np.ndarray, "s+h o"],
    hidden: Float[np.ndarray, " l"],
) -> Float[np.ndarray, "n o"]:
    """Decorrelated innovations of the scored rows, of an engine with h further states, zero at first, and l further
    terms with the values `hidden`."""
    count, rows, outputs = given.measured.shape
    more = len(engine.schema.state) - given.first.shape[1]
    x = np.hstack([given.first, np.zeros((count, more))])
    effort = no_effort(engine, count)
    raw = np.zeros((len(given.scored), rows - 1, outputs))
    for t in range(rows - 1):
        terms = np.hstack([given.terms[:, t], np.tile(hidden, (count, 1))])
        then = engine.rows(phi, terms, x, given.command[:, t], effort)
        e = given.measured[:, t + 1] - then[:, :outputs]
        raw[given.scored, t] = e
        x = then + e @ gain.T
        x = np.where(np.isfinite(x), x, 0.0)
    return decorrelate(problem, raw)
