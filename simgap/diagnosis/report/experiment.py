"""The short command sequence that would tell two explanations apart, within what the robot was seen to do."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from simgap.diagnosis.hypotheses.features import inside
from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate
from simgap.diagnosis.likelihood.segments import LENGTH, RUN_IN, as_chunks, cut, sent_before
from simgap.diagnosis.likelihood.student_t import log_density
from simgap.diagnosis.validation.forecast import Contestant, Regimes, forecast
from simgap.kinematics import motion
from simgap.rows import by_row
from simgap.types import Recording

SECONDS = 6.0
MARGIN = 0.1
"""Share by which a sequence may leave the recorded range of reach, height and velocities."""
CLEAR = 3.0
"""Times the noise of an output by which a sequence must move it."""
SETTLED = float(np.log(20))
"""Nats that settle a question: odds of 20 to 1."""


class Experiment(NamedTuple):
    """A sequence of commands, what it is in words, and by how much it tells two models apart [nats]."""

    time_s: Float[np.ndarray, " T"]
    commands: Float[np.ndarray, "T u"]
    words: str
    nats: float


class NoExperiment(NamedTuple):
    """Why no sequence of commands is proposed."""

    reason: str


def design(
    problem: Problem, a: Fit, b: Fit, about: Sequence[Hypothesis], regimes: Regimes, recordings: list[Recording]
) -> Experiment | NoExperiment:
    """The sequence, of a library of steps, reversals, ramps and sweeps of each command, that separates a from b most.

    `about`: the effects in question. The sequence commands one of their channels and moves one of their outputs, within
    what was recorded of the robot.
    """
    dt, schema = problem.scales.time_step, problem.augmented.simulator.schema
    rows = max(int(SECONDS / dt), LENGTH)
    channels = {c for hypothesis in about for c in hypothesis.channels} or {f.name for f in schema.command}
    outputs = {o for hypothesis in about for o in hypothesis.outputs} or {f.name for f in schema.state}
    limits = np.max([np.abs(r.command).max(0) for r in recordings], axis=0)
    asked = np.array([f.name in channels for f in schema.command], bool)
    library = [(words, u) for words, u in _library(problem, rows, limits) if u[:, asked].any()]
    if not library:
        return NoExperiment("nothing can be commanded that these explanations depend on")
    seen = _forecast(problem, a, [u for _, u in library], regimes, recordings)
    possible = _within(problem, seen, recordings)
    if not possible.any():
        return NoExperiment("no sequence of commands keeps the simulated robot within what was recorded")
    possible &= _moves(problem, a, seen, [f.name in outputs for f in schema.state])
    if not possible.any():
        return NoExperiment(f"no sequence of commands moves {', '.join(sorted(outputs))} clearly beyond the noise")
    apart = np.where(possible, 0.0, -np.inf)
    apart[possible] = _apart(problem, a, b, [(seen[i], library[i][1]) for i in np.flatnonzero(possible)], regimes)
    best = int(np.argmax(apart))
    if apart[best] < SETTLED:
        return NoExperiment(
            f"the best sequence of commands would separate them by {max(apart[best], 0.0):.1f} nats only"
        )
    words, commands = library[best]
    return Experiment(np.arange(rows) * dt, commands, words, float(apart[best]))


def _forecast(
    problem: Problem, fit: Fit, commands: list[np.ndarray], regimes: Regimes, recordings: list[Recording]
) -> Float[np.ndarray, "n t s"]:
    """What a model would measure under sequences of commands, from rest."""
    rows, dt = len(commands[0]), problem.scales.time_step
    state, still = _at_rest(recordings), np.zeros((RUN_IN, commands[0].shape[1]))
    parts = [
        (np.repeat(state[None], RUN_IN + rows + 1, 0), np.concatenate([still, u, u[-1:]]),
         *sent_before(still, 0), np.arange(RUN_IN + rows + 1) * dt, np.ones(RUN_IN + rows + 1),
         np.ones(RUN_IN + rows, bool), np.ones((len(regimes), RUN_IN + rows + 1)), 0, 0)
        for u in commands
    ]  # fmt: skip
    return forecast(problem, Contestant(fit.v, regimes=regimes), as_chunks(parts))


def _moves(
    problem: Problem, fit: Fit, states: Float[np.ndarray, "n t s"], asked: Sequence[bool]
) -> Bool[np.ndarray, " n"]:
    """Which forecasts move one of the outputs in question clearly beyond its noise."""
    noise = 1.4826 * np.median(np.abs(fit.e @ np.linalg.inv(problem.whiten).T), axis=0)
    return (np.ptp(states, axis=1) > CLEAR * noise)[:, np.array(asked)].any(1)


def _apart(
    problem: Problem, a: Fit, b: Fit, simulated: Sequence[tuple[np.ndarray, np.ndarray]], regimes: Regimes
) -> Float[np.ndarray, " n"]:
    """Log-likelihood ratio [nats] of a over b on what a would measure, by the noise that the recordings leave a.

    Row by row, as recordings are judged: errors that only add up over seconds are no evidence. -inf where b leaves the
    finite numbers.
    """
    dt, least = problem.scales.time_step, len(problem.chunks.row)
    # What a measures after a row's command comes with the next one.
    sessions = [
        Recording(str(i), np.arange(len(u)) * dt, y, np.concatenate([u[1:], u[-1:]]))
        for i, (y, u) in enumerate(simulated)
    ]
    at_once = max(least // -(-len(sessions[0].time_s) // LENGTH), 1)
    found = []
    for first in range(0, len(sessions), at_once):
        chunks = cut(sessions[first : first + at_once], dt, least)
        gate = np.stack([inside(problem.augmented.layout, r, chunks) for r in regimes], axis=1).astype(np.float32)
        there = problem._replace(chunks=chunks._replace(gate=gate))
        ends = np.cumsum(np.asarray(chunks.counts).sum(1))
        of = np.repeat(chunks.session, np.diff(ends, prepend=0))
        ours, theirs = (evaluate(there, f.v, (), a.noise) for f in (a, b))
        with np.errstate(invalid="ignore", over="ignore"):
            nats = (log_density(ours.e, a.noise) - log_density(theirs.e, a.noise)).sum(1)
        total = np.bincount(of, nats, len(sessions[first : first + at_once]))
        found.append(np.where(np.isfinite(total), total, -np.inf))
    return np.concatenate(found)


def _library(problem: Problem, rows: int, limits: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """(words, commands [rows, u]) for every channel, at three sizes, and for pairs of channels of one body."""
    t = np.arange(rows) * problem.scales.time_step
    fields = problem.augmented.simulator.schema.command
    period = SECONDS / 3
    shapes = {
        "a step": (t > 0.5) & (t < SECONDS / 2),
        "reversals": np.where(t > 0.5, np.sign(np.sin(2 * np.pi * t / period)), 0.0),
        "fast reversals": np.where(t > 0.5, np.sign(np.sin(2 * np.pi * t / (period / 3))), 0.0),
        "a ramp": np.clip(t / SECONDS, 0, 1),
        "a slow triangle": 2 * np.abs(((t / SECONDS + 0.25) % 1) - 0.5) * 2 - 1,
        "a sweep": np.sin(2 * np.pi * (0.2 + 0.15 * t) * t),
    }
    for i, f in enumerate(fields):
        for name, shape in shapes.items():
            for size in (0.15, 0.5, 1.0):
                for sign in (1.0, -1.0):
                    u = np.zeros((rows, len(fields)))
                    u[:, i] = sign * size * limits[i] * shape
                    yield f"{name} of {sign * size * limits[i]:.2g} {f.unit} on {f.name}", u
        for j, g in enumerate(fields):
            if i < j:
                u = np.zeros((rows, len(fields)))
                u[:, i], u[:, j] = 0.5 * limits[i] * shapes["reversals"], 0.5 * limits[j] * shapes["a sweep"]
                yield f"reversals on {f.name} with a sweep on {g.name}", u


def _at_rest(recordings: list[Recording]) -> Float[np.ndarray, " s"]:
    """A recorded state in which nothing is commanded, or the least."""
    r = recordings[0]
    size = np.abs(r.command / np.maximum(np.abs(r.command).max(0), 1e-9)).sum(1)
    return r.state[int(np.argmin(size))]


def _within(
    problem: Problem, states: Float[np.ndarray, "n t s"], recordings: list[Recording]
) -> Bool[np.ndarray, " n"]:
    """Which forecasts keep velocities, and the bodies' own positions where they are mounted, in the recorded range."""
    layout = problem.augmented.layout
    every = np.concatenate([r.state for r in recordings])
    fast = [i for i, f in enumerate(layout.schema.state) if f.kind == "velocity"]
    possible = np.asarray(np.isfinite(states).all((1, 2)) & _in_range(states[..., fast], every[:, fast]))
    if not any(c is not None for c in layout.carrier):
        return possible
    recorded, positions = (by_row(motion, layout, x).position for x in (every, states))
    kept = _in_range(positions.reshape(*states.shape[:2], -1), recorded.reshape(len(recorded), -1))
    return possible & kept


def _in_range(values: Float[np.ndarray, "n t k"], recorded: Float[np.ndarray, "m k"]) -> Bool[np.ndarray, " n"]:
    """Which series keep all values within the range of what was recorded, or little beyond."""
    low, high = recorded.min(0), recorded.max(0)
    slack = MARGIN * (high - low)
    return np.asarray(((values >= low - slack) & (values <= high + slack)).all((1, 2)))
