"""Rows that scatter more than others: noise that grows with motion, rows that come late, lost commands.

Each is another distribution of the innovations, row by row (`row_mixture`), and they compete: with each other, with
rows that are wide in no direction, and with misfit along the directions in which lost commands would move the rows.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from simgap.diagnosis import row_mixture
from simgap.diagnosis.fit import Fit, Noise, Problem, evaluate, log_density, raw_innovations, replaced, row_trials
from simgap.diagnosis.innovations import Chunks
from simgap.diagnosis.rivals import compared
from simgap.diagnosis.row_mixture import Law, Mixture
from simgap.diagnosis.scatter_claim import OTHER, OWED, Axis, Between, Scatter, Widening
from simgap.diagnosis.screen import blocks
from simgap.effects import CATALOGUE
from simgap.effects.augmented import Slot
from simgap.layout import Layout, motion

SURE = 3.5
"""Standard deviations, over blocks of rows, by which the gain of what acts in all rows must exceed zero."""
ODDEST = 3
"""Blocks of rows without which the gain of what acts in few rows must suffice: it has to happen again and again."""
STALLS = np.array([0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0])
"""Further nominal intervals that a late row may contain."""
SPANS = np.convolve([-1.5, -1.0, -0.5, 0.0, *STALLS, 8.0], [0.5, 0.5], "valid")
"""Edges of a picture's bins, one about each of these, in further nominal intervals."""
EVEN = np.arange(-1.125, 2.2, 0.25)
"""The same where there are no such lengths."""
HELD = (1, 2, 3, 4)
"""Rows for which a lost command leaves the last one acting."""
RARE, COMMON = 0.02, 0.3
"""Shares of rows with which the fit of a component begins, of what acts in few rows and in many."""
SPREAD = 0.3
"""Standard deviation of an amplitude, and slope of the noise by the motion, with which their fits begin."""


class Robot(NamedTuple):
    """What is said of it. interval: [s] that rows span by the positions' own advance, which need not be the nominal
    step; integrated: positions whose velocities are measured; bodies: each one's outputs; subsystems: what may lose its
    commands together, each with the outputs of its bodies."""

    interval: float
    time_step: float
    outputs: tuple[str, ...]
    integrated: tuple[str, ...]
    bodies: Mapping[str, Int[np.ndarray, " c"]]
    subsystems: list[tuple[str, tuple[str, ...]]]


class Sample(NamedTuple):
    """One set of sessions under the model of the mean: decorrelated innovations, and what the hypotheses need.

    moving: how fast the robot, and each of its bodies, goes at that, 1 at the usual speed. advance: what a further
    interval adds. held: innovations of every row, had an earlier command acted there, for each of the subsystems.
    """

    e: Float[np.ndarray, "n s"]
    moving: Float[np.ndarray, "n 1+b"]
    advance: Float[np.ndarray, "n s"]
    held: list[Float[np.ndarray, "k n s"]]
    starts: np.ndarray


class _Fitted(NamedTuple):
    """A hypothesis: its law of any sample, its constants, ln p of the training rows, and the number of constants beyond
    those of noise without a name."""

    id: str
    law: Callable[[Sample], Law]
    mixture: Mixture
    density: Float[np.ndarray, " n"]
    constants: int
    rare: bool = False
    about: int = 0
    """Body (0: all) or subsystem."""


def of_rows(problem: Problem, fit: Fit, unseen: Chunks) -> Scatter | None:
    """The best word for rows that scatter more than others, if it is better than noise without a name."""
    training, heldout = (_sample(problem._replace(chunks=c), fit) for c in (problem.chunks, unseen))
    return explained(_robot(problem), fit.noise, training, heldout)


def explained(robot: Robot, noise: Noise, training: Sample, heldout: Sample) -> Scatter | None:
    """The same, of samples."""
    groups = (np.arange(len(robot.outputs)), *(b for b in robot.bodies.values() if 0 < len(b) < len(robot.outputs)))
    plain = _fit(OTHER, lambda s: Law(groups, s.e[:0, None]), training, row_mixture.of_plain(noise, groups))
    independent = log_density(training.e, noise).sum(1)
    named = [*_late_rows(plain, training), *_motion(robot, plain, training), *_lost_commands(plain, training)]
    named = [f for f in named if _certain(f, plain, independent, training.starts)]
    # Where the noise of one of these fits better without its law as well, that was no merit of the law.
    number = len(plain.mixture.shares)
    noises = [row_mixture.without_shifts(f.mixture, len(f.mixture.shares) - number) for f in named]
    plain = max((plain, *(_fit(OTHER, plain.law, training, m) for m in noises)), key=_score)
    named = [f for f in named if _certain(f, plain, independent, training.starts)]
    if not named:
        return None
    held = {f.about for f in named if f.id == "dropout"}
    others = [plain, *(m for i in held for m in _misfit(plain, training, i))]
    best = {f.id: f for f in sorted([*others, *named], key=_score)}
    lead = max(best.values(), key=_score)
    gain = lead.density - plain.density
    if lead.id == OTHER:
        return None
    odds = compared(
        {k: f.density for k, f in best.items()},
        {k: f.constants for k, f in best.items()},
        training.starts,
        lead.id,
        float(gain.sum()),
    )
    seen = [row_mixture.density(f.law(heldout), heldout.e, f.mixture) for f in (lead, plain)]
    held_gain = float((seen[0] - seen[1]).sum())
    if held_gain <= 0:
        return None
    said = {"dropout": _lost, "motion_dependent_noise": _wide, "sampling_interval": _late if lead.rare else _uneven}
    return Scatter(
        id=lead.id, rare=lead.rare, gain=float(gain.sum()), heldout_gain=held_gain, odds=odds,
        **said[lead.id](robot, training, lead),
    )  # fmt: skip


def _score(f: _Fitted) -> float:
    """Log-likelihood less log n / 2 a constant."""
    return float(f.density.sum()) - 0.5 * f.constants * np.log(max(len(f.density), 1))


def _robot(problem: Problem) -> Robot:
    layout = problem.augmented.layout
    schema, names = layout.schema, tuple(f.name for f in layout.schema.state)
    bodies = {b: np.array([i for i, f in enumerate(schema.state) if f.body == b], int) for b in layout.bodies}
    subsystems = [("", names)]
    for channels in _subsystems(layout)[1:]:
        own = {schema.command[c].body for c in channels}
        subsystems.append((f" of {', '.join(sorted(own))}", tuple(f.name for f in schema.state if f.body in own)))
    integrated = layout.integrates >= 0
    interval = float(np.median(problem.scales.interval[integrated])) if integrated.any() else problem.scales.time_step
    positions = tuple(n for n, own in zip(names, integrated, strict=True) if own)
    return Robot(interval, problem.scales.time_step, names, positions, bodies, subsystems)


def _subsystems(layout: Layout) -> list[list[int]]:
    """Channels that may lose their commands together: all, or those of one body."""
    fields = layout.schema.command
    of_bodies = [[i for i, f in enumerate(fields) if f.body == body] for body in layout.bodies]
    every = list(range(len(fields)))
    return [every, *(channels for channels in of_bodies if channels and channels != every)]


def _sample(problem: Problem, fit: Fit) -> Sample:
    chunks = problem.chunks
    layout, scales = problem.augmented.layout, problem.scales
    counts = np.asarray(chunks.counts)
    # As predicted: what was measured in a row holds the row's own noise, and would be large where that is.
    state = (np.asarray(chunks.state)[:, 1:] - raw_innovations(problem, fit.v))[counts]
    speed, moves = np.maximum(scales.speed, 1e-6), scales.speed > 1e-6
    squared = np.asarray(jax.vmap(lambda s: (motion(layout, s).velocity / speed) ** 2 * moves)(jnp.asarray(state)))
    each = squared.sum(2) / np.maximum(moves.sum(1), 1)
    whole = squared.mean((1, 2)) if layout.bodies else np.zeros(len(state))
    moving = np.sqrt(np.column_stack([whole, each]))
    integrates = layout.integrates
    rate = np.where(integrates >= 0, state[:, np.maximum(integrates, 0)], 0.0) * scales.interval
    keys, theta = [effect.key for effect in CATALOGUE], fit.v.theta
    held = []
    for channels in _subsystems(layout):
        delays = [problem.augmented.index[Slot(keys.index("delay"), 0, s)] for s in channels]
        held.append(row_trials(problem, fit.v, [replaced(theta, delays, theta[delays] + k) for k in HELD]))
    e = evaluate(problem, fit.v, fit.groups, fit.noise).e
    usual = np.quantile(moving, 0.95, axis=0) if len(moving) else np.ones(moving.shape[1])
    return Sample(e, moving / np.maximum(usual, 1e-9), rate @ problem.whiten.T, held, blocks(counts))


def _certain(f: _Fitted, plain: _Fitted, independent: Float[np.ndarray, " n"], starts: np.ndarray) -> bool:
    """Whether a hypothesis gains more than chance over noise without a name, blocks of rows being independent.

    What is rare has its gain in few blocks, whose spread would be all of it: it must happen again and again. Wide rows
    may share the credit for each of these, so there it counts against noise that is independent in every output.
    """
    gain = f.density - plain.density
    if f.rare:
        again = np.sort(np.add.reduceat(f.density - independent, starts))[:-ODDEST].sum()
        return bool(gain.sum() > OWED and again > OWED)
    per_block = np.add.reduceat(gain, starts)
    return bool(gain.sum() > OWED and gain.sum() > SURE * np.sqrt((per_block**2).sum()))


def _fit(
    name: str, law: Callable[[Sample], Law], sample: Sample, start: Mixture, constants: int = 0, **more: Any
) -> _Fitted:
    mixture, density = row_mixture.fitted(law(sample), sample.e, start)
    return _Fitted(name, law, mixture, density, constants, **more)


def _groups(plain: _Fitted, sample: Sample) -> tuple[Int[np.ndarray, " g"], ...]:
    return plain.law(sample).groups


def _late_rows(plain: _Fitted, sample: Sample) -> list[_Fitted]:
    """Rows in which the robot moved on for longer than the nominal interval, or for an uneven time, all positions
    alike."""
    if not sample.advance.any():
        return []
    groups = _groups(plain, sample)
    late = lambda s: Law(groups, STALLS[:, None, None] * s.advance)  # noqa: E731
    uneven = lambda s: Law(groups, s.advance[None], free=True, everywhere=True)  # noqa: E731
    begun = row_mixture.with_shifts(plain.mixture, np.full(len(STALLS), RARE))
    every = row_mixture.with_shifts(plain.mixture, np.array([1 - COMMON]))._replace(mean=0.0, sd=SPREAD)
    stalls = _fit("sampling_interval", late, sample, begun, rare=True)
    stalls = stalls._replace(constants=int((stalls.mixture.shares[-len(STALLS) :] * len(sample.e) >= 1).sum()))
    return [stalls, _fit("sampling_interval", uneven, sample, every, 1)]


def _motion(robot: Robot, plain: _Fitted, sample: Sample) -> list[_Fitted]:
    """Noise of all outputs by all motion, or of a body's by its own."""
    groups, found = _groups(plain, sample), []
    for k, columns in enumerate([np.arange(len(robot.outputs)), *robot.bodies.values()]):
        if k and not 0 < len(columns) < len(robot.outputs):
            continue
        own = np.isin(np.arange(len(robot.outputs)), columns)
        law = lambda s, k=k, own=own: Law(groups, s.e[:0, None], moving=s.moving[:, [k]] * own)  # noqa: E731
        found.append(_fit("motion_dependent_noise", law, sample, plain.mixture._replace(slope=SPREAD), 1, about=k))
    return found


def _held(groups: tuple[Int[np.ndarray, " g"], ...], i: int, free: bool) -> Callable[[Sample], Law]:
    return lambda s: Law(groups, s.e - s.held[i], bursts=True, free=free)


def _lost_commands(plain: _Fitted, sample: Sample) -> list[_Fitted]:
    """Rows in which an earlier command acts instead of the one sent: of the subsystems, the one that gains most.

    By the whole way from one to the other, or about it: an estimate that follows the state late sees less, or more.
    """
    begun = row_mixture.with_shifts(plain.mixture, np.full(len(HELD), RARE))
    groups, number = _groups(plain, sample), range(len(sample.held))
    exact = [_fit("dropout", _held(groups, i, False), sample, begun, about=i) for i in number]
    best = max(exact, key=_score)
    law, start = _held(groups, best.about, True), best.mixture._replace(sd=SPREAD)
    return [_fit("dropout", law, sample, start, len(HELD) + 1, rare=True, about=best.about)]


def _misfit(plain: _Fitted, sample: Sample, i: int) -> list[_Fitted]:
    """Rows that are moved along the way from the command sent to an earlier one, but not about all of it.

    In many rows about none of it, either way; or in some about half: as where the response to commands differs from
    the model's.
    """
    law = _held(_groups(plain, sample), i, True)
    many, few = np.array([COMMON, *[RARE] * (len(HELD) - 1)]), np.full(len(HELD), RARE)
    begun = [
        row_mixture.with_shifts(plain.mixture, s)._replace(mean=m, sd=SPREAD) for m, s in ((0.0, many), (0.5, few))
    ]
    return [_fit(OTHER, law, sample, start, len(HELD) + 1) for start in begun]


def _constant(sample: Sample, f: _Fitted, name: str, unit: str, of: Callable[[Mixture], float]) -> dict[str, Any]:
    law = f.law(sample)
    interval = (row_mixture.burst_interval if law.bursts else row_mixture.interval)(
        law, sample.e, f.mixture, sample.starts, of
    )
    return {"name": name, "value": of(f.mixture), "unit": unit, "ci95": interval}


def _late(robot: Robot, training: Sample, f: _Fitted) -> dict[str, Any]:
    last = len(STALLS)
    share = _constant(training, f, "share of stalls", "-", lambda m: float(m.shares[-last:].sum()))
    length = _constant(
        training, f, "length of stalls", "s",
        lambda m: robot.interval * float(1 + m.shares[-last:] @ STALLS / m.shares[-last:].sum()),
    )  # fmt: skip
    several = [training.e, *(training.e - k * training.advance for k in STALLS)]
    return {
        "constants": [share, length], "outputs": robot.integrated,
        "shown": _spans(robot, several, training, _of_shifts(f.mixture, last), f.mixture.noise, SPANS),
        "statement": f"Rows are not evenly spaced in time: {share['value']:.0%} of them hold a stall and span about "
        f"{length['value']:.2f} s of motion.",
    }  # fmt: skip


def _uneven(robot: Robot, training: Sample, f: _Fitted) -> dict[str, Any]:
    jitter = _constant(training, f, "jitter", "s", lambda m: m.sd * robot.interval)
    nodes = np.linspace(-3, 3, 25)
    shares = np.exp(-0.5 * nodes**2)
    several = [training.e - f.mixture.sd * z * training.advance for z in nodes]
    return {
        "constants": [jitter], "outputs": robot.integrated,
        "shown": _spans(robot, several, training, shares / shares.sum(), f.mixture.noise, EVEN),
        "statement": "Rows are not evenly spaced in time: the time that they span scatters by "
        f"{jitter['value']:.3f} s.",
    }  # fmt: skip


def _spans(
    robot: Robot, several: list[np.ndarray], training: Sample, shares: np.ndarray, noise: Noise, edges: np.ndarray
) -> Between:
    """The time that rows span, by how far the robot went in them."""
    axis = Axis("time a row spans, by the way covered [s]", robot.interval, robot.interval, edges)
    return Between(several, training.advance, shares, noise, axis)


def _of_shifts(mixture: Mixture, number: int) -> Float[np.ndarray, " k"]:
    """Shares of the rows that are not shifted, and of those that are."""
    return np.append(mixture.shares[:-number].sum(), mixture.shares[-number:])


def _wide(robot: Robot, training: Sample, f: _Fitted) -> dict[str, Any]:
    law = f.law(training)
    assert law.moving is not None  # its noise grows with the motion
    columns = np.flatnonzero(law.moving.any(0))
    names = tuple(robot.outputs[i] for i in columns)
    where = "" if f.about == 0 else f" of {list(robot.bodies)[f.about - 1]}"
    ratio = _constant(training, f, "ratio", "-", lambda m: 1 + m.slope)
    noise = Noise(f.mixture.noise.scale[columns], f.mixture.noise.dof[columns])
    return {
        "constants": [ratio], "outputs": names,
        "shown": Widening(training.e[:, columns], noise, training.moving[:, f.about], ratio["value"]),
        "statement": f"The scatter{where} grows with the motion: {ratio['value']:.1f} times as wide when moving as at "
        "rest; error bars are wrong, not means.",
    }  # fmt: skip


def _lost(robot: Robot, training: Sample, f: _Fitted) -> dict[str, Any]:
    last, held = len(HELD), training.held[f.about]
    rate = _constant(training, f, "rate", "1/min", lambda m: 60 / robot.time_step * float(m.shares[-last]))
    length = _constant(
        training, f, "length", "s",
        lambda m: robot.time_step * float(m.shares[-last:].sum() / max(m.shares[-last], 1e-9)),
    )  # fmt: skip
    low, high = length["ci95"]  # within its last row a burst may end anywhere
    length["ci95"] = [max(low - robot.time_step / 2, 0.0), high + robot.time_step / 2]
    of, outputs = robot.subsystems[f.about]
    axis = Axis("command that acts: 0 the one sent, 1 the last [-]", 0.0, 1.0, EVEN)
    shares = _of_shifts(f.mixture, last)
    return {
        "constants": [rate, length], "outputs": outputs,
        "shown": Between([training.e, *held], training.e - held[0], shares, f.mixture.noise, axis),
        "statement": f"Commands{of} are lost now and then ({rate['value']:.1f} times a minute, for about "
        f"{length['value']:.2f} s), and the last one acts on.",
    }  # fmt: skip
