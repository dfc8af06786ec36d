"""Rows under the model of the mean: innovations, and how stalls and lost commands would shift them."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from simgap.diagnosis.inference.evidence.null_distribution import blocks
from simgap.diagnosis.inference.noise.row_mixture_em import Law, Mixture
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, raw_innovations, replaced, row_trials
from simgap.effects.augmented import Slot
from simgap.kinematics import motion
from simgap.layout import Layout
from simgap.rows import by_row

STALLS = np.array([0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0])
"""Additional nominal intervals that a late row may contain."""
HELD = (1, 2, 3, 4)
"""Ages [rows] of the last command received, which acts while later ones are lost."""


class Robot(NamedTuple):
    """What the statements refer to.

    interval: time [s] that a row spans by the positions' own advance, which may differ from the nominal step.
    integrated: positions whose velocities are measured. bodies: the outputs of each. subsystems: what may lose its
    commands together, each with the outputs of its bodies.
    """

    interval: float
    time_step: float
    outputs: tuple[str, ...]
    integrated: tuple[str, ...]
    bodies: Mapping[str, Int[np.ndarray, " c"]]
    subsystems: list[tuple[str, tuple[str, ...]]]


class Sample(NamedTuple):
    """One set of sessions under the model of the mean: decorrelated innovations, and what the hypotheses need.

    moving: predicted speed of the robot and of each body, 1 at the usual speed. advance: what an additional interval
    adds to the innovations. held: innovations of every row if an earlier command had acted there, for each subsystem.
    """

    e: Float[np.ndarray, "n s"]
    moving: Float[np.ndarray, "n 1+b"]
    advance: Float[np.ndarray, "n s"]
    held: list[Float[np.ndarray, "k n s"]]
    starts: np.ndarray


class Growth(NamedTuple):
    """Noise that grows with motion. says: in words. column: of `Sample.moving`, for each output. grows: whether its
    noise does."""

    says: str
    column: Int[np.ndarray, " s"]
    grows: Bool[np.ndarray, " s"]

    def moving(self, sample: Sample) -> Float[np.ndarray, "n s"]:
        """The motion with which each output's noise grows; zero where it does not."""
        return sample.moving[:, self.column] * self.grows


class Fitted(NamedTuple):
    """A fitted hypothesis: its law, given a sample; its constants; ln p of the training rows; and the number of
    constants beyond those of unnamed noise."""

    id: str
    law: Callable[[Sample], Law]
    mixture: Mixture
    density: Float[np.ndarray, " n"]
    constants: int
    rare: bool = False
    about: int = 0
    """Index of the growth or of the subsystem."""


def robot_of(problem: Problem) -> Robot:
    layout = problem.augmented.layout
    schema, names = layout.schema, tuple(f.name for f in layout.schema.outputs)
    bodies = {b: np.array([i for i, f in enumerate(schema.outputs) if f.body == b], int) for b in layout.bodies}
    subsystems = [("", names)]
    for channels in _subsystems(layout)[1:]:
        own = {schema.command[c].body for c in channels}
        subsystems.append((f" of {', '.join(sorted(own))}", tuple(f.name for f in schema.outputs if f.body in own)))
    integrated = layout.integrates[layout.observed] >= 0
    advance = problem.scales.interval[layout.observed][integrated]
    interval = float(np.median(advance)) if integrated.any() else problem.scales.time_step
    positions = tuple(n for n, own in zip(names, integrated, strict=True) if own)
    return Robot(interval, problem.scales.time_step, names, positions, bodies, subsystems)


def growths(robot: Robot) -> list[Growth]:
    """Noise of all outputs that grows with all motion, of one body's with its own, or of every body's with its own."""
    count, own = len(robot.outputs), np.zeros(len(robot.outputs), int)
    found = [Growth("The noise grows with the motion", own.copy(), np.full(count, True))]
    for k, (body, columns) in enumerate(robot.bodies.items(), 1):
        if 0 < len(columns) < count:
            own[columns] = k
            found.append(Growth(f"The noise of {body} grows with the motion", np.full(count, k), own == k))
    every = Growth("The noise of every body grows with its own motion", own, np.full(count, True))
    return [*found, every] if len(found) > 2 else found


def _subsystems(layout: Layout) -> list[list[int]]:
    """Channels that may lose their commands together: all, or those of one body."""
    fields = layout.schema.command
    of_bodies = [[i for i, f in enumerate(fields) if f.body == body] for body in layout.bodies]
    everything = list(range(len(fields)))
    return [everything, *(channels for channels in of_bodies if channels and channels != everything)]


def sample_of(problem: Problem, fit: Fit) -> Sample:
    chunks = problem.chunks
    layout, scales = problem.augmented.layout, problem.scales
    counts = np.asarray(chunks.counts)
    # The speed is that of the predicted state: a measured one contains the row's own noise and grows with it.
    state = np.array(chunks.state)[:, 1:]
    outputs = len(problem.whiten)
    state[..., :outputs] -= raw_innovations(problem, fit.v)
    state = state[counts]
    speed, moves = np.maximum(scales.speed, 1e-6), scales.speed > 1e-6
    squared = (by_row(motion, layout, state).velocity / speed) ** 2 * moves
    by_body = squared.sum(2) / np.maximum(moves.sum(1), 1)
    overall = squared.mean((1, 2)) if layout.bodies else np.zeros(len(state))
    moving = np.sqrt(np.column_stack([overall, by_body]))
    integrates = layout.integrates
    rate = np.where(integrates >= 0, state[:, np.maximum(integrates, 0)], 0.0) * scales.interval
    keys, theta = [effect.key for effect in problem.augmented.catalogue], fit.v.theta
    held = []
    for channels in _subsystems(layout):
        delays = [problem.augmented.index[Slot(keys.index("delay"), 0, s)] for s in channels]
        held.append(row_trials(problem, fit.v, [replaced(theta, delays, theta[delays] + k) for k in HELD]))
    e = evaluate(problem, fit.v, fit.groups, fit.noise).e
    usual = np.quantile(moving, 0.95, axis=0) if len(moving) else np.ones(moving.shape[1])
    return Sample(e, moving / np.maximum(usual, 1e-9), rate[:, :outputs] @ problem.whiten.T, held, blocks(counts))
