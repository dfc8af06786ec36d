"""The short command sequence that best separates two explanations, within the recorded range of the robot."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.diagnosis.likelihood.segments import LENGTH, RUN_IN, as_chunks, sent_before
from simgap.diagnosis.likelihood.ways import TURNED
from simgap.diagnosis.report.separation import apart, apart_refitted
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
HELD_S = (0.1, 0.3)
"""How long a random binary signal keeps its value [s]. It excites a wide band of frequencies, which separates
dynamics that look alike [Ljung 1999, section 13.3]."""
RUNS = 4
"""How often an experiment is run, each time from another place: one run of some seconds seldom decides."""
REFITTED = 24
"""Number of sequences for which the other model is refitted: those that separate the models best as they are, each of
another kind."""


class _Sequence(NamedTuple):
    """Commands; kind: what their sizes and signs have in common."""

    kind: str
    words: str
    commands: Float[np.ndarray, "T u"]


class Experiment(NamedTuple):
    """A sequence of commands, its description, and the log-likelihood ratio [nats] that `RUNS` runs of it give.

    Of the first model over the other, which has been fitted again to the recordings and these runs together.
    """

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
    """The sequence that best separates a from b, from a library of commands such as steps, sweeps and random signals.

    `about`: the effects in question. The sequence commands one of their channels and moves one of their outputs. It
    keeps the robot within its recorded range.
    """
    dt, schema = problem.scales.time_step, problem.augmented.simulator.schema
    rows = max(int(SECONDS / dt), LENGTH)
    channels = {c for hypothesis in about for c in hypothesis.channels} or {f.name for f in schema.command}
    outputs = {o for hypothesis in about for o in hypothesis.outputs} or {f.name for f in schema.state}
    limits = np.max([np.abs(r.command).max(0) for r in recordings], axis=0)
    in_channels = np.array([f.name in channels for f in schema.command], bool)
    library = [s for s in _library(problem, rows, limits) if s.commands[:, in_channels].any()]
    if not library:
        return NoExperiment("the recordings never use the commands that these explanations depend on")
    simulated = _forecast(problem, a, [s.commands for s in library], regimes, recordings)
    possible = _within(problem, simulated, recordings)
    if not possible.any():
        return NoExperiment("every sequence of commands takes the simulated robot out of its recorded range")
    possible &= _moves(problem, a, simulated, [f.name in outputs for f in schema.state])
    if not possible.any():
        return NoExperiment(f"no sequence of commands moves {', '.join(sorted(outputs))} clearly beyond the noise")
    runs, (chosen,) = [(s.commands, y) for s, y in zip(library, simulated, strict=True)], np.nonzero(possible)
    as_fitted = apart(problem, a, b, [runs[i] for i in chosen], regimes)
    likely = _best_of_each_kind(library, chosen[np.argsort(-as_fitted)].tolist())[:REFITTED]
    nats = apart_refitted(problem, a, b, [runs[i] for i in likely], regimes, RUNS)
    best = int(np.argmax(nats))
    if nats[best] < SETTLED:
        return NoExperiment(
            f"the best sequence of commands separates them by only {max(nats[best], 0.0):.1f} nats in {RUNS} runs"
        )
    _, words, commands = library[likely[best]]
    return Experiment(np.arange(rows) * dt, commands, words, float(nats[best]))


def _forecast(
    problem: Problem, fit: Fit, commands: list[np.ndarray], regimes: Regimes, recordings: list[Recording]
) -> Float[np.ndarray, "n t s"]:
    """Measurements that a model predicts under sequences of commands, from rest."""
    rows, dt = len(commands[0]), problem.scales.time_step
    state, still = _at_rest(recordings), np.zeros((RUN_IN, commands[0].shape[1]))
    parts = [
        (np.repeat(state[None], RUN_IN + rows + 1, 0), np.concatenate([still, u, u[-1:]]),
         *sent_before(still, 0), np.repeat(state[None], TURNED, 0), np.arange(RUN_IN + rows + 1) * dt,
         np.ones(RUN_IN + rows + 1), np.ones(RUN_IN + rows, bool), np.ones((len(regimes), RUN_IN + rows + 1)), 0, 0)
        for u in commands
    ]  # fmt: skip
    return forecast(problem, Contestant(fit.v, regimes=regimes), as_chunks(parts))


def _moves(
    problem: Problem, fit: Fit, states: Float[np.ndarray, "n t s"], in_outputs: Sequence[bool]
) -> Bool[np.ndarray, " n"]:
    """Which forecasts move one of the outputs in question clearly beyond its noise.

    A velocity that recordings lack is seen in the position that it changes.
    """
    layout, asked = problem.augmented.layout, np.array(in_outputs)
    noise = 1.4826 * np.median(np.abs(fit.e @ np.linalg.inv(problem.whiten).T), axis=0)
    hidden_rate = (layout.integrates >= 0) & ~layout.observed[layout.integrates]
    asked = (asked | hidden_rate & asked[layout.integrates])[layout.observed]
    return np.asarray((np.ptp(states[..., layout.observed], axis=1) > CLEAR * noise)[:, asked].any(1))


def _best_of_each_kind(library: Sequence[_Sequence], best_first: Sequence[int]) -> list[int]:
    """The first sequence of every kind."""
    first: dict[str, int] = {}
    for i in best_first:
        first.setdefault(library[i].kind, i)
    return list(first.values())


def _library(problem: Problem, rows: int, limits: np.ndarray) -> Iterator[_Sequence]:
    """Sequences for every channel at three sizes, and for every pair of channels."""
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
        **{f"random switching every {held_s:g} s": _random_binary(t, held_s) for held_s in HELD_S},
    }
    for i, f in enumerate(fields):
        for name, shape in shapes.items():
            for size in (0.15, 0.5, 1.0):
                for sign in (1.0, -1.0):
                    u = np.zeros((rows, len(fields)))
                    u[:, i] = sign * size * limits[i] * shape
                    kind = f"{name} on {f.name}"
                    yield _Sequence(kind, f"{name} of {sign * size * limits[i]:.2g} {f.unit} on {f.name}", u)
        for j, g in enumerate(fields):
            if i < j:
                u = np.zeros((rows, len(fields)))
                u[:, i], u[:, j] = 0.5 * limits[i] * shapes["reversals"], 0.5 * limits[j] * shapes["a sweep"]
                kind = f"reversals on {f.name} with a sweep on {g.name}"
                yield _Sequence(kind, kind, u)


def _random_binary(t: Float[np.ndarray, " T"], held_s: float) -> Float[np.ndarray, " T"]:
    """A signal of 1 and -1 that changes at random, after half a second of rest; the same each time."""
    values = np.random.default_rng(0).choice((-1.0, 1.0), int(t[-1] / held_s) + 1)
    return np.where(t > 0.5, values[(t / held_s).astype(int)], 0.0)


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
