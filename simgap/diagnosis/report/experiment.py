"""The short command sequence that best separates two explanations, within the recorded range of the robot."""

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
"""Share of the recorded range by which positions and velocities may exceed it."""
CLEAR = 3.0
"""A sequence must move an output by more than this multiple of its noise."""
SETTLED = float(np.log(20))
"""Minimum log-likelihood ratio [nats] of an experiment: odds of 20 to 1."""


class Experiment(NamedTuple):
    """A sequence of commands, its description, and the log-likelihood ratio of two models that it gives [nats]."""

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
    """The sequence that best separates a from b, from a library of steps, reversals, ramps and sweeps of each command.

    `about`: the effects in question. The sequence commands one of their channels and moves one of their outputs. It
    keeps the robot within its recorded range.
    """
    dt, schema = problem.scales.time_step, problem.augmented.simulator.schema
    rows = max(int(SECONDS / dt), LENGTH)
    channels = {c for hypothesis in about for c in hypothesis.channels} or {f.name for f in schema.command}
    outputs = {o for hypothesis in about for o in hypothesis.outputs} or {f.name for f in schema.state}
    limits = np.max([np.abs(r.command).max(0) for r in recordings], axis=0)
    in_channels = np.array([f.name in channels for f in schema.command], bool)
    library = [(words, u) for words, u in _library(problem, rows, limits) if u[:, in_channels].any()]
    if not library:
        return NoExperiment("the recordings never use the commands that these explanations depend on")
    simulated = _forecast(problem, a, [u for _, u in library], regimes, recordings)
    possible = _within(problem, simulated, recordings)
    if not possible.any():
        return NoExperiment("every sequence of commands takes the simulated robot out of its recorded range")
    possible &= _moves(problem, a, simulated, [f.name in outputs for f in schema.state])
    if not possible.any():
        return NoExperiment(f"no sequence of commands moves {', '.join(sorted(outputs))} clearly beyond the noise")
    nats = np.where(possible, 0.0, -np.inf)
    nats[possible] = _log_ratio(
        problem, a, b, [(simulated[i], library[i][1]) for i in np.flatnonzero(possible)], regimes
    )
    best = int(np.argmax(nats))
    if nats[best] < SETTLED:
        return NoExperiment(f"the best sequence of commands separates them by only {max(nats[best], 0.0):.1f} nats")
    words, commands = library[best]
    return Experiment(np.arange(rows) * dt, commands, words, float(nats[best]))


def _forecast(
    problem: Problem, fit: Fit, commands: list[np.ndarray], regimes: Regimes, recordings: list[Recording]
) -> Float[np.ndarray, "n t s"]:
    """Measurements that a model predicts under sequences of commands, from rest."""
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
    problem: Problem, fit: Fit, states: Float[np.ndarray, "n t s"], in_outputs: Sequence[bool]
) -> Bool[np.ndarray, " n"]:
    """Which forecasts move one of the outputs in question clearly beyond its noise."""
    noise = 1.4826 * np.median(np.abs(fit.e @ np.linalg.inv(problem.whiten).T), axis=0)
    return (np.ptp(states, axis=1) > CLEAR * noise)[:, np.array(in_outputs)].any(1)


def _log_ratio(
    problem: Problem, a: Fit, b: Fit, simulated: Sequence[tuple[np.ndarray, np.ndarray]], regimes: Regimes
) -> Float[np.ndarray, " n"]:
    """Log-likelihood ratio [nats] of a over b on measurements simulated by a, with a's noise in the recordings.

    It is a sum over one-step predictions, as in a diagnosis: errors that only add up over seconds are no evidence.
    -inf where b diverges.
    """
    dt, least = problem.scales.time_step, len(problem.chunks.row)
    # y[t] is measured after command u[t], so it is in one row with u[t + 1].
    sessions = [
        Recording(str(i), np.arange(len(u)) * dt, y, np.concatenate([u[1:], u[-1:]]))
        for i, (y, u) in enumerate(simulated)
    ]
    at_once = max(least // -(-len(sessions[0].time_s) // LENGTH), 1)
    ratios = []
    for first in range(0, len(sessions), at_once):
        chunks = cut(sessions[first : first + at_once], dt, least)
        gate = np.stack([inside(problem.augmented.layout, r, chunks) for r in regimes], axis=1).astype(np.float32)
        simulated_problem = problem._replace(chunks=chunks._replace(gate=gate))
        ends = np.cumsum(np.asarray(chunks.counts).sum(1))
        session = np.repeat(chunks.session, np.diff(ends, prepend=0))
        own, other = (evaluate(simulated_problem, f.v, (), a.noise) for f in (a, b))
        with np.errstate(invalid="ignore", over="ignore"):
            nats = (log_density(own.e, a.noise) - log_density(other.e, a.noise)).sum(1)
        total = np.bincount(session, nats, len(sessions[first : first + at_once]))
        ratios.append(np.where(np.isfinite(total), total, -np.inf))
    return np.concatenate(ratios)


def _library(problem: Problem, rows: int, limits: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """(description, commands [rows, u]) for every channel at three sizes, and for every pair of channels."""
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
    """The recorded state with the smallest command."""
    r = recordings[0]
    size = np.abs(r.command / np.maximum(np.abs(r.command).max(0), 1e-9)).sum(1)
    return r.state[int(np.argmin(size))]


def _within(
    problem: Problem, states: Float[np.ndarray, "n t s"], recordings: list[Recording]
) -> Bool[np.ndarray, " n"]:
    """Which forecasts keep velocities, and positions of mounted bodies in their own frames, in the recorded range."""
    layout = problem.augmented.layout
    all_states = np.concatenate([r.state for r in recordings])
    velocities = [i for i, f in enumerate(layout.schema.state) if f.kind == "velocity"]
    possible = np.asarray(
        np.isfinite(states).all((1, 2)) & _in_range(states[..., velocities], all_states[:, velocities])
    )
    if not any(c is not None for c in layout.carrier):
        return possible
    recorded, positions = (by_row(motion, layout, x).position for x in (all_states, states))
    kept = _in_range(positions.reshape(*states.shape[:2], -1), recorded.reshape(len(recorded), -1))
    return possible & kept


def _in_range(values: Float[np.ndarray, "n t k"], recorded: Float[np.ndarray, "m k"]) -> Bool[np.ndarray, " n"]:
    """Which series keep all values within the recorded range, give or take `MARGIN` of it."""
    low, high = recorded.min(0), recorded.max(0)
    slack = MARGIN * (high - low)
    return np.asarray(((values >= low - slack) & (values <= high + slack)).all((1, 2)))
