"""How a push of a body shows in the innovations: in the row that it acts in, and in a few after it.

A push fades, for the bodies follow their commands and the estimate follows the measurements. So the echoes of one push
in every row add up to what any law of pushes, however it varies from row to row, changes in the innovations.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from simgap.diagnosis.candidates import candidates
from simgap.diagnosis.fit import Group, Problem, raw_innovations, replaced, side_by_side
from simgap.diagnosis.innovations import Variables, estimates_of
from simgap.layout import X, Y

ROWS = 8
"""Rows in which a push shows."""

Echo = Float[np.ndarray, "C T-1 k s"]
"""What a push of one unit in each row changes in the decorrelated innovations of that row and the k - 1 after it."""


def echoes(problem: Problem, v: Variables) -> dict[str, Echo]:
    """Along the bodies' own axes, and along the world's where a body that turns moves over the ground."""
    # What acts for a while only hardly changes how a push echoes, and the gate is the pushes' here.
    v = v._replace(gated=np.zeros_like(v.gated))
    drifts = [c for c in candidates(problem.augmented, problem.scales) if c.effect.id == "body_frame_bias"]
    own = {c.where: _echo(problem, v, c.groups[0], c.starts[0][0]) for c in drifts if len(c.sites) == 1}
    layout, world = problem.augmented.layout, {}
    state = np.asarray(estimates_of(problem.augmented, problem.scales, v, problem.chunks))
    for b, body in enumerate(layout.bodies):
        heading, names = layout.heading[b], layout.outputs(b, (X, Y))
        if heading is not None and len(names) == 2 and all(name in own for name in names):
            ahead, across = (own[name] for name in names)
            c, s = (turn(state[..., heading])[..., None, None] for turn in (np.cos, np.sin))
            world[f"{body} along the world's x"] = c * ahead - s * across
            world[f"{body} along the world's y"] = s * ahead + c * across
    return own | world


def _echo(problem: Problem, v: Variables, drift: Group, size: float) -> Echo:
    """By pushes of this size in every so many rows, once from each row on."""
    still, chunks = raw_innovations(problem, v), problem.chunks
    pushed = v._replace(gated=replaced(v.gated, drift.entries, size))

    def change(first: int) -> Float[np.ndarray, "C T-1 s"]:
        gate = np.zeros(chunks.gate.shape, np.float32)
        gate[:, first::ROWS] = 1.0
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
