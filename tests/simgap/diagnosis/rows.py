"""Innovations drawn directly, row by row: plain, or with one thing planted. Cheap enough for hundreds of data sets."""

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import BLOCK
from simgap.diagnosis.inference.noise.sample import HELD, Robot, Sample

STEP = 1 / 15
NAMES = tuple("abcdef")
ROBOT = Robot(STEP, STEP, NAMES, NAMES[:2], {"base": np.arange(3), "hand": np.arange(3, 6)}, [("", NAMES)])
ROWS, UNSEEN = 1200, 400
"""Fitted rows, and held-out ones."""
STALL, JITTER, SLOPE = 0.05, 0.4, 2.0
"""Share of rows that hold a stall of one or two intervals; standard deviation of intervals; growth of the noise."""
LOST, BURST = 0.02, 3
"""Chance that a command begins a burst of lost ones, and rows of a burst."""
NULLS = ("heavy tails", "outliers", "outliers along axes", "growing noise", "lag", "deadband", "rate limit")
"""Where no command is lost and no row is late."""


def drawn(kind: str, seed: int) -> tuple[Sample, Sample]:
    """Samples to fit and held out, of one machine: six outputs, three commands, plain noise of scale 1."""
    rng = np.random.default_rng([seed, *kind.encode()])
    n, before = ROWS + UNSEEN, 2 * len(HELD)
    sent = _commands(rng, n + before)
    response, way = 3 * rng.normal(size=(3, 6)), 3 * rng.normal(size=(3, 2))
    u = sent[before:]
    advance = np.hstack([u @ way, np.zeros((n, 4))])
    moving = np.sqrt(np.column_stack([(u[:, own] ** 2).mean(1) for own in ([0, 1, 2], [0], [1, 2])]))
    moving /= np.quantile(moving, 0.95, axis=0)
    plain = rng.standard_t(8, size=(n, 6))
    e = _planted(kind, rng, plain, moving, advance) + (_acting(kind, rng, sent) - sent)[before:] @ response
    held = np.stack([e + (u - sent[before - k : -k]) @ response for k in HELD])

    def part(rows: slice) -> Sample:
        starts = np.arange(0, len(e[rows]), BLOCK)
        return Sample(e[rows], moving[rows], advance[rows], [held[:, rows]], starts)

    return part(slice(0, ROWS)), part(slice(ROWS, None))


def _commands(rng: np.random.Generator, rows: int) -> Float[np.ndarray, "n 3"]:
    """They move towards goals that change now and then, and rest there."""
    u, goal = np.zeros((rows, 3)), np.zeros(3)
    for t in range(1, rows):
        goal = rng.normal(size=3) if rng.random() < 0.1 else goal
        u[t] = u[t - 1] + np.clip(goal - u[t - 1], -0.3, 0.3)
    return u


def _acting(kind: str, rng: np.random.Generator, u: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The commands that act, of those sent."""
    acting, left = u.copy(), 0
    for t in range(1, len(u)):
        match kind:
            case "lost commands":
                left = BURST if left == 0 and rng.random() < LOST else left
                if left:
                    acting[t], left = acting[t - 1], left - 1
            case "lag":
                acting[t] = u[t] - 0.12 * (u[t] - u[t - 1])
            case "rate limit":
                acting[t] = acting[t - 1] + np.clip(u[t] - acting[t - 1], -0.25, 0.25)
            case "deadband":
                acting[t] = np.sign(u[t]) * np.maximum(np.abs(u[t]) - 0.05, 0)
    return acting


def _planted(
    kind: str,
    rng: np.random.Generator,
    plain: Float[np.ndarray, "n s"],
    moving: Float[np.ndarray, "n 3"],
    advance: Float[np.ndarray, "n s"],
) -> Float[np.ndarray, "n s"]:
    """Noise of every row, and what unevenly spaced rows add."""
    n, s = plain.shape
    odd = (rng.random(n) < 0.03)[:, None]
    late = (rng.random(n) < STALL) * rng.choice([1.0, 2.0], size=n)
    match kind:
        case "heavy tails":  # of all outputs together
            return rng.normal(size=(n, s)) / np.sqrt(rng.chisquare(2.5, size=(n, 1)) / 2.5)
        case "outliers":
            return plain * np.where(odd, 8, 1)
        case "outliers along axes":
            return plain + odd * 6 * rng.normal(size=(n, s))
        case "growing noise":
            return plain * (1 + SLOPE * moving[:, [0]])
        case "growing noise of each":  # where joints stick and slip, for example
            return plain * (1 + SLOPE * np.repeat(moving[:, 1:], 3, axis=1))
        case "stalls":
            return plain + late[:, None] * advance
        case "jitter":
            return plain + JITTER * rng.normal(size=(n, 1)) * advance
    return plain
