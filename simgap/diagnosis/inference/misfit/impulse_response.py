"""Impulse responses: how a push of a body changes the innovations of its own row and of a few rows after it.

A push fades, because the bodies follow their commands and the estimate follows the measurements. So the change by any
law of pushes, however it varies from row to row, is the sum of these responses (echoes).
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.inference.evidence.null_distribution import Evidence
from simgap.diagnosis.likelihood.problem import Group, Problem, estimates, raw_innovations, with_value
from simgap.diagnosis.likelihood.variables import Variables
from simgap.layout import X, Y
from simgap.threads import side_by_side

ROWS = 8
"""Length of an impulse response [rows]."""
DRIFTS = ("body_frame_bias", "constant_load")
"""Effects that push steadily along one axis: of a body, and of a joint."""
LEAST_LEFT = 0.02
"""Share of a law's information that the model cannot absorb. Below this it is a rounding error and counts as zero."""
Echo = Float[np.ndarray, "C T-1 k s"]
"""Impulse responses: change of the decorrelated innovations of a row and the k - 1 after it, by a unit push in it."""


def own_echoes(problem: Problem, v: Variables, axes: Collection[str] | None = None) -> dict[str, Echo]:
    """Impulse responses along the bodies' own axes, or along those in `axes`."""
    # Effects that act in a support hardly change the responses, so the pushes take the place of all supports.
    v = v._replace(delta=np.zeros_like(v.delta[:1]))
    problem = problem._replace(chunks=problem.chunks._replace(gate=problem.chunks.gate[:, :1]))
    drifts = [c for c in hypotheses_of(problem.augmented, problem.scales) if c.effect.id in DRIFTS]
    still = raw_innovations(problem, v)
    drifts = [c for c in drifts if len(c.sites) == 1 and (axes is None or c.where in axes)]
    return {c.where: _echo(problem, v, still, c.groups[0], c.starts[0][0]) for c in drifts}


def echoes(problem: Problem, v: Variables) -> dict[str, Echo]:
    """Impulse responses along bodies' own axes, and along the world's for bodies that turn and move on the ground."""
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
    """Responses to pushes of this size in every `ROWS`-th row, from each row on. still: innovations without pushes."""
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
    force = np.stack(pushes).astype(np.float32)[..., None]
    d = force * echo[:, :, 0]
    for k in range(1, ROWS):
        d[:, :, k:] += force[:, :, :-k] * echo[:, :-k, k]
    return d[:, np.asarray(problem.chunks.counts)]


class Heard(NamedTuple):
    """What a unit push in each row does to the likelihood. Laws are tested with it, without computing their directions.

    score: of such a push. overlap: inner products of the responses to pushes k = 0 ... ROWS - 1 rows apart. absorbed:
    the part along each of the r directions that the model absorbs.
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
    """Test the pushes along one axis. root: of the weights; residual and basis are already multiplied by it."""
    counts = np.asarray(problem.chunks.counts)

    def placed(rows: np.ndarray) -> np.ndarray:
        """Values of the rows that count at their places in the segments, with zeros after their ends."""
        padded = np.zeros((counts.shape[0], counts.shape[1] + ROWS, *rows.shape[1:]), np.float32)
        padded[:, : counts.shape[1]][counts] = rows
        return padded

    outputs, rows = root.shape[1], counts.shape[1]
    weight, left = placed(root), placed(residual.reshape(-1, outputs))
    along = placed(basis.reshape(len(root), outputs, -1))
    responses = [echo[:, :, k] * weight[:, k : k + rows] for k in range(ROWS)]
    later = lambda a, k: np.concatenate([a[:, k:], np.zeros_like(a[:, :k])], axis=1)  # noqa: E731
    total = lambda parts: np.sum(list(parts), axis=0)  # noqa: E731
    return Heard(
        -total((responses[k] * left[:, k : k + rows]).sum(2) for k in range(ROWS)),
        np.stack(
            [total((responses[j + k] * later(responses[j], k)).sum(2) for j in range(ROWS - k)) for k in range(ROWS)]
        ),
        total(np.einsum("cts,ctsr->ctr", responses[k], along[:, k : k + rows]) for k in range(ROWS)),
    )


def evidence(heard: Heard, pushes: Sequence[Float[np.ndarray, "C T-1"]]) -> Evidence:
    """Score and information of laws of pushes, by the row in which they push.

    The information is the part that the model cannot absorb.
    """
    force = np.stack(pushes).astype(np.float32)
    information = force * heard.overlap[0]
    for k in range(1, ROWS):
        information[:, :, :-k] += heard.overlap[k][:, :-k] * force[:, :, k:]
        information[:, :, k:] += heard.overlap[k][:, :-k] * force[:, :, :-k]
    score, power = ((force * per_push).reshape(len(force), -1) for per_push in (heard.score, information))
    absorbed = force.reshape(len(force), -1) @ heard.absorbed.reshape(score.shape[1], -1)
    share = 1 - (absorbed**2).sum(1) / np.maximum(power.sum(1), 1e-9)
    share = np.where(share > LEAST_LEFT, share, 0.0)[:, None]
    return Evidence(score * (share > 0), power * share, np.full(len(force), True))
