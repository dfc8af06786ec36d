"""How a push of a body shows in the innovations: in the row that it acts in, and in a few after it.

A push fades, for the bodies follow their commands and the estimate follows the measurements. So the echoes of one push
in every row add up to what any law of pushes, however it varies from row to row, changes in the innovations.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.inference.null_distribution import Evidence
from simgap.diagnosis.likelihood.filter import Variables
from simgap.diagnosis.likelihood.problem import Group, Problem, estimates, raw_innovations, side_by_side, with_value
from simgap.layout import X, Y

ROWS = 8
"""Rows in which a push shows."""
DRIFTS = ("body_frame_bias", "constant_load")
"""Effects that push steadily along one axis: of bodies, and of joints."""
LEAST_LEFT = 0.02
"""Share of what pushes change that a model cannot absorb, below which what is left is rounding."""
Echo = Float[np.ndarray, "C T-1 k s"]
"""What a push of one unit in each row changes in the decorrelated innovations of that row and the k - 1 after it."""


def own_echoes(problem: Problem, v: Variables, axes: Collection[str] | None = None) -> dict[str, Echo]:
    """Along the bodies' own axes, or some of them."""
    # What acts for a while only hardly changes how a push echoes: the pushes take the place of all supports.
    v = v._replace(delta=np.zeros_like(v.delta[:1]))
    problem = problem._replace(chunks=problem.chunks._replace(gate=problem.chunks.gate[:, :1]))
    drifts = [c for c in hypotheses_of(problem.augmented, problem.scales) if c.effect.id in DRIFTS]
    still = raw_innovations(problem, v)
    drifts = [c for c in drifts if len(c.sites) == 1 and (axes is None or c.where in axes)]
    return {c.where: _echo(problem, v, still, c.groups[0], c.starts[0][0]) for c in drifts}


def echoes(problem: Problem, v: Variables) -> dict[str, Echo]:
    """Along the bodies' own axes, and along the world's where a body that turns moves over the ground."""
    own, layout, world = own_echoes(problem, v), problem.augmented.layout, {}
    state = estimates(problem, v)
    for b, body in enumerate(layout.bodies):
        heading, names = layout.heading[b], layout.outputs(b, (X, Y))
        if heading is not None and len(names) == 2 and all(name in own for name in names):
            ahead, across = (own[name] for name in names)
            c, s = (turn(state[..., heading])[..., None, None] for turn in (np.cos, np.sin))
            world[f"{body} along the world's x"] = c * ahead - s * across
            world[f"{body} along the world's y"] = s * ahead + c * across
    return own | world


def _echo(problem: Problem, v: Variables, still: Float[np.ndarray, "C T-1 s"], drift: Group, size: float) -> Echo:
    """By pushes of this size in every so many rows, once from each row on; `still` are innovations without them."""
    chunks = problem.chunks
    pushed = with_value(v, drift._replace(support=1), size)

    def change(first: int) -> Float[np.ndarray, "C T-1 s"]:
        gate = np.zeros(chunks.gate.shape, np.float32)
        gate[..., first::ROWS] = 1.0
        with_pushes = problem._replace(chunks=chunks._replace(gate=jnp.asarray(gate)))
        return (raw_innovations(with_pushes, pushed) - still) / size @ problem.whiten.T.astype(np.float32)

    chunk, rows, outputs = still.shape
    echo = np.zeros((chunk, rows, ROWS, outputs), np.float32)
    for first, d in enumerate(side_by_side(change, range(ROWS))):
        for k in range(ROWS):
            pushes = np.arange(first, rows - k, ROWS)
            echo[:, pushes, k] = d[:, pushes + k]
    return echo


def direction(problem: Problem, echo: Echo, pushes: Sequence[Float[np.ndarray, "C T-1"]]) -> Float[np.ndarray, "f n s"]:
    """Change of the decorrelated innovations, in the rows that count, by pushes that vary from row to row."""
    each = np.stack(pushes).astype(np.float32)[..., None]
    d = each * echo[:, :, 0]
    for k in range(1, ROWS):
        d[:, :, k:] += each[:, :, :-k] * echo[:, :-k, k]
    return d[:, np.asarray(problem.chunks.counts)]


class Heard(NamedTuple):
    """What a push of one unit in each row does to the likelihood, so that laws are weighed without their directions.

    score: along the residual. overlap: products of the echoes of pushes k = 0 ... ROWS - 1 rows apart. absorbed: the
    part along each of the r directions that the model absorbs.
    """

    score: Float[np.ndarray, "C T-1"]
    overlap: Float[np.ndarray, "k C T-1"]
    absorbed: Float[np.ndarray, "C T-1 r"]


def hear(
    problem: Problem,
    echo: Echo,
    root: Float[np.ndarray, "n s"],
    residual: Float[np.ndarray, " n*s"],
    basis: Float[np.ndarray, "n*s r"],
) -> Heard:
    """Of one axis; `root` are the roots of the weights, that residual and basis hold already."""
    counts = np.asarray(problem.chunks.counts)

    def placed(rows: np.ndarray) -> np.ndarray:
        """What belongs to rows that count, in the chunks, and nothing behind their ends."""
        found = np.zeros((counts.shape[0], counts.shape[1] + ROWS, *rows.shape[1:]), np.float32)
        found[:, : counts.shape[1]][counts] = rows
        return found

    outputs, rows = root.shape[1], counts.shape[1]
    weight, rest = placed(root), placed(residual.reshape(-1, outputs))
    along = placed(basis.reshape(len(root), outputs, -1))
    each = [echo[:, :, k] * weight[:, k : k + rows] for k in range(ROWS)]
    later = lambda a, k: np.concatenate([a[:, k:], np.zeros_like(a[:, :k])], axis=1)  # noqa: E731
    total = lambda parts: np.sum(list(parts), axis=0)  # noqa: E731
    return Heard(
        -total((each[k] * rest[:, k : k + rows]).sum(2) for k in range(ROWS)),
        np.stack([total((each[j + k] * later(each[j], k)).sum(2) for j in range(ROWS - k)) for k in range(ROWS)]),
        total(np.einsum("cts,ctsr->ctr", each[k], along[:, k : k + rows]) for k in range(ROWS)),
    )


def evidence(heard: Heard, pushes: Sequence[Float[np.ndarray, "C T-1"]]) -> Evidence:
    """What speaks for laws of pushes, by the row in which they push: score, and what the model cannot absorb of the
    information."""
    each = np.stack(pushes).astype(np.float32)
    met = each * heard.overlap[0]
    for k in range(1, ROWS):
        met[:, :, :-k] += heard.overlap[k][:, :-k] * each[:, :, k:]
        met[:, :, k:] += heard.overlap[k][:, :-k] * each[:, :, :-k]
    score, power = ((each * a).reshape(len(each), -1) for a in (heard.score, met))
    absorbed = each.reshape(len(each), -1) @ heard.absorbed.reshape(score.shape[1], -1)
    left = 1 - (absorbed**2).sum(1) / np.maximum(power.sum(1), 1e-9)
    left = np.where(left > LEAST_LEFT, left, 0.0)[:, None]
    return Evidence(score * (left > 0), power * left, np.full(len(each), True))
