"""The short command sequence that would tell two explanations apart, within what the robot was seen to do."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from simgap.diagnosis.black_box import silent
from simgap.diagnosis.fit import Fit, Problem
from simgap.diagnosis.forecast import forecast
from simgap.diagnosis.innovations import RUN_IN, as_chunks, sent_before
from simgap.effects.regime import Regime
from simgap.layout import motion
from simgap.types import Recording

SECONDS = 6.0
MARGIN = 0.1
"""Share by which a sequence may leave the recorded range of reach and height."""


class Experiment(NamedTuple):
    """A sequence of commands, what it is in words, and by how much it tells two models apart [nats]."""

    time_s: Float[np.ndarray, " T"]
    commands: Float[np.ndarray, "T u"]
    words: str
    nats: float


def design(problem: Problem, a: Fit, b: Fit, regime: Regime, recordings: list[Recording]) -> Experiment | None:
    """The sequence, of a library of steps, reversals, ramps and sweeps of each command, that separates a from b most.

    None where no sequence stays within the robot's recorded reach.
    """
    dt = problem.scales.time_step
    rows = max(int(SECONDS / dt), 40)
    limits = np.max([np.abs(r.command).max(0) for r in recordings], axis=0)
    library = list(_library(problem, rows, limits))
    state = _at_rest(recordings)
    still = np.zeros((RUN_IN, len(limits)))
    parts = [
        (np.repeat(state[None], RUN_IN + rows + 1, 0), np.concatenate([still, u, u[-1:]]),
         *sent_before(still, 0), np.arange(RUN_IN + rows + 1) * dt, np.ones(RUN_IN + rows + 1),
         np.ones(RUN_IN + rows, bool), np.ones(RUN_IN + rows + 1), 0, 0)
        for _, u in library
    ]  # fmt: skip
    pieces = as_chunks(parts)
    box = silent(problem.augmented.layout)
    seen = [forecast(problem.augmented, problem.scales, f.v, pieces, box, regime) for f in (a, b)]
    apart = 0.5 * (((seen[0] - seen[1]) @ problem.whiten.T / a.noise.scale) ** 2).sum((1, 2))
    apart[~_within(problem, seen[0], recordings)] = -1.0
    best = int(np.nanargmax(apart))
    if not apart[best] > 0:
        return None
    words, commands = library[best]
    return Experiment(np.arange(rows) * dt, commands, words, float(apart[best]))


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


def _within(problem: Problem, states: Float[np.ndarray, "n t s"], recordings: list[Recording]) -> np.ndarray:
    """Which forecasts keep the bodies' own positions in the recorded range."""
    layout = problem.augmented.layout
    if not any(c is not None for c in layout.carrier):
        return np.asarray(np.isfinite(states).all((1, 2)))
    own = jax.jit(jax.vmap(lambda s: motion(layout, s).position))
    recorded = np.asarray(own(jnp.asarray(np.concatenate([r.state for r in recordings]), jnp.float32)))
    low, high = recorded.min(0), recorded.max(0)
    slack = MARGIN * (high - low)
    positions = np.asarray(own(jnp.asarray(states.reshape(-1, states.shape[-1]))))
    inside = ((positions >= low - slack) & (positions <= high + slack)).all((1, 2))
    return inside.reshape(states.shape[:2]).all(1)
