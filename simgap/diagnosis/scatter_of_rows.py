"""Rows that scatter more than others: noise that grows with motion, rows that come late, lost commands.

Each is another distribution of the innovations, row by row.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.special import logsumexp

from simgap.diagnosis.fit import (
    Fit,
    Noise,
    Problem,
    evaluate,
    fit_noise,
    log_density,
    raw_innovations,
    replaced,
    row_trials,
)
from simgap.diagnosis.innovations import Chunks
from simgap.diagnosis.scatter_claim import OWED, Axis, Between, Scatter, Widening
from simgap.diagnosis.screen import blocks
from simgap.effects import CATALOGUE
from simgap.effects.augmented import Slot
from simgap.layout import Layout, motion

SURE = 3.5
"""Standard deviations, over blocks of rows, by which the gain of what acts in all rows must exceed zero."""
ODDEST = 3
"""Blocks of rows without which the gain of what acts in few rows must suffice: it has to happen again and again."""
RATIOS = np.geomspace(1.05, 12, 18) - 1
"""By which the scatter may grow when moving as usual,"""
FINER = 6
"""with so many further ones on either side of the best."""
STALLS = np.array([0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0])
"""Further nominal intervals that a late row may contain."""
SPANS = np.convolve([-1.5, -1.0, -0.5, 0.0, *STALLS, 8.0], [0.5, 0.5], "valid")
"""Edges of a picture's bins, one about each of these, in further nominal intervals."""
EVEN = np.arange(-1.125, 2.2, 0.25)
"""The same where there are no such lengths."""
JITTERS = np.geomspace(0.03, 0.6, 10)
"""Standard deviations of the rows' intervals that are tried, in nominal ones."""
NODES = np.concatenate([[0.0], *([-z, z] for z in np.arange(0.25, 3.1, 0.25))])
"""Values of a standard normal variable, the plain one first, over which a row's interval is averaged."""
HELD = (1, 2, 3, 4)
"""Rows for which a lost command leaves the last one acting."""


class _Sample(NamedTuple):
    """One set of sessions under the model of the mean: decorrelated innovations, and what the hypotheses need.

    moving: how fast the robot, and each of its bodies, goes at that, 1 at the usual speed. held: innovations of every
    row, had an earlier command acted there, for each of the channels' `_subsystems`.
    """

    e: Float[np.ndarray, "n s"]
    moving: Float[np.ndarray, "n 1+b"]
    advance: Float[np.ndarray, "n s"]
    held: list[Float[np.ndarray, "k n s"]]
    starts: np.ndarray


def of_rows(problem: Problem, fit: Fit, unseen: Chunks) -> Scatter | None:
    """The best word for rows that scatter more than others."""
    training, heldout = (_sample(problem._replace(chunks=c), fit) for c in (problem.chunks, unseen))
    mine = (problem, fit.noise, training, heldout)
    rare = [r for r in (_late_rows(*mine), _lost_commands(*mine)) if r is not None]
    # What has a name of its own goes before scatter that grows; of words for the same rows, the better one.
    wide = [w for w in (_jitter(*mine), None if rare else _motion(*mine)) if w is not None]
    return max((*rare, *wide), key=lambda s: s.gain, default=None)


def _sample(problem: Problem, fit: Fit) -> _Sample:
    chunks = problem.chunks
    layout, scales = problem.augmented.layout, problem.scales
    counts = np.asarray(chunks.counts)
    # As foretold: what was measured in a row holds the row's own noise, and would be large where that is.
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
    return _Sample(e, moving / np.maximum(usual, 1e-9), rate @ problem.whiten.T, held, blocks(counts))


def _density(e: Float[np.ndarray, "n s"], noise: Noise) -> Float[np.ndarray, " n"]:
    return log_density(e, noise).sum(1)


def _certain(gain: Float[np.ndarray, " n"], starts: np.ndarray, rare: bool) -> bool:
    """Whether a gain per row is more than chance, blocks of rows being independent.

    What is rare has its gain in few blocks, whose spread would be all of it.
    """
    per_block = np.add.reduceat(gain, starts)
    if rare:
        return bool(np.sort(per_block)[:-ODDEST].sum() > OWED)
    return bool(gain.sum() > OWED and gain.sum() > SURE * np.sqrt((per_block**2).sum()))


def _claim(
    name: str, training: _Sample, heldout: _Sample, gain: Callable[[_Sample], np.ndarray], rare: bool, **said: Any
) -> Scatter | None:
    g, h = gain(training), gain(heldout)
    if not _certain(g, training.starts, rare) or h.sum() <= 0:
        return None
    return Scatter(id=name, rare=rare, gain=float(g.sum()), heldout_gain=float(h.sum()), **said)


def _motion(problem: Problem, noise: Noise, training: _Sample, heldout: _Sample) -> Scatter | None:
    """All outputs by all motion, or a body's by its own: the one of these that gains most."""
    fields, bodies = problem.augmented.simulator.schema.state, problem.augmented.layout.bodies
    of_bodies = [np.array([i for i, f in enumerate(fields) if f.body == body], int) for body in bodies]
    places = [np.arange(len(fields)), *of_bodies]
    found = [
        _widening(problem, noise, training, heldout, k, columns)
        for k, columns in enumerate(places)
        if k == 0 or 0 < len(columns) < len(fields)
    ]
    return max((f for f in found if f is not None), key=lambda s: s.gain, default=None)


def _widening(
    problem: Problem, noise: Noise, training: _Sample, heldout: _Sample, k: int, columns: Int[np.ndarray, " c"]
) -> Scatter | None:
    """Scale of some outputs times (1 + c m), m the motion k: the ratio is that of moving as usual to standing still."""
    plain = Noise(noise.scale[columns], noise.dof[columns])

    def density(sample: _Sample, c: float, noise: Noise | None = None) -> tuple[Float[np.ndarray, " n"], Noise]:
        wide = 1 + c * sample.moving[:, k, None]
        e = sample.e[:, columns] / wide
        noise = noise or fit_noise(e)
        return _density(e, noise) - len(columns) * np.log(wide[:, 0]), noise

    def best_of(ratios: Float[np.ndarray, " r"]) -> tuple[int, Float[np.ndarray, " r"]]:
        logliks = np.array([density(training, c)[0].sum() for c in ratios])
        return int(logliks.argmax()), logliks

    at, _ = best_of(RATIOS)
    finer = np.linspace(RATIOS[max(at - 1, 0)], RATIOS[min(at + 1, len(RATIOS) - 1)], 2 * FINER + 1)
    at, logliks = best_of(finer)
    c, inside = float(finer[at]), finer[logliks > logliks[at] - 2]
    _, fitted = density(training, c)
    gain = lambda sample: density(sample, c, fitted)[0] - _density(sample.e[:, columns], plain)  # noqa: E731
    constant = {
        "name": "ratio",
        "value": 1 + c,
        "unit": "-",
        "ci95": [1 + float(inside.min()), 1 + float(inside.max())],
    }
    names = _all(problem)
    where = "" if len(columns) == len(names) else f" of {problem.augmented.layout.bodies[k - 1]}"
    return _claim(
        "motion_dependent_noise", training, heldout, gain, rare=False, constants=[constant],
        shown=Widening(training.e[:, columns], fitted, training.moving[:, k], 1 + c),
        outputs=tuple(names[i] for i in columns),
        statement=f"The scatter{where} grows with the motion: {1 + c:.1f} times as wide when moving as at rest; error "
        "bars are wrong, not means.",
    )  # fmt: skip


class _Mixture(NamedTuple):
    shares: Float[np.ndarray, " k"]
    noise: Noise
    chance: Float[np.ndarray, "n k"]


def _mix(e: list[np.ndarray], noise: Noise) -> _Mixture:
    """Expectation maximisation of rows that follow one of several innovations; the first is the plain one."""
    shares = np.full(len(e), 0.02)
    shares[0] = 1 - shares[1:].sum()
    chance = np.zeros((len(e[0]), len(e)))
    for _ in range(15):
        chance = _chance(_joint(e, shares, noise))
        shares = np.maximum(chance.mean(0), 1e-9)
        chosen = chance.argmax(1)
        noise = fit_noise(np.stack(e)[chosen, np.arange(len(chosen))])
    return _Mixture(shares, noise, chance)


def _joint(e: list[np.ndarray], shares: Float[np.ndarray, " k"], noise: Noise) -> Float[np.ndarray, "n k"]:
    """Log-density of every row together with the innovations that it follows."""
    return np.stack([_density(x, noise) for x in e], axis=1) + np.log(shares)


def _chance(joint: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """Which innovations a row follows, given the row."""
    return np.exp(joint - logsumexp(joint, axis=1, keepdims=True))


def _mixed_gain(mixture: _Mixture, e: list[np.ndarray], noise: Noise) -> np.ndarray:
    return logsumexp(_joint(e, mixture.shares, mixture.noise), axis=1) - _density(e[0], noise)


def _late_rows(problem: Problem, noise: Noise, training: _Sample, heldout: _Sample) -> Scatter | None:
    """Rows in which the robot moved on for longer than the nominal interval, all positions alike."""
    several = lambda s: [s.e, *(s.e - k * s.advance for k in STALLS)]  # noqa: E731
    mixture = _mix(several(training), noise)
    share = float(mixture.shares[1:].sum())
    longer = float(mixture.shares[1:] @ STALLS / max(share, 1e-9))
    interval = _interval(problem)
    length = interval * (1 + longer)
    sd = np.sqrt(share * (1 - share) / len(training.e))
    constants = [
        {"name": "share of stalls", "value": share, "unit": "-", "ci95": [max(share - 2 * sd, 0.0), share + 2 * sd]},
        {"name": "length of stalls", "value": length, "unit": "s", "ci95": [length * 0.8, length * 1.2]},
    ]
    return _claim(
        "sampling_interval", training, heldout, lambda s: _mixed_gain(mixture, several(s), noise), rare=True,
        constants=constants, outputs=_integrated(problem),
        shown=_spans(interval, several(training), training, mixture, SPANS),
        statement="Rows are not evenly spaced in time: "
        f"{share:.0%} of them hold a stall and span about {length:.2f} s of motion.",
    )  # fmt: skip


def _jitter(problem: Problem, noise: Noise, training: _Sample, heldout: _Sample) -> Scatter | None:
    """Rows that span more or less than the nominal interval, each by chance, all positions alike."""
    shares = np.exp(-0.5 * NODES**2)
    shares /= shares.sum()
    at = lambda s, sd: [s.e - sd * z * s.advance for z in NODES]  # noqa: E731
    drawn = np.random.default_rng(0).random(len(training.e))

    def fitted(sd: float) -> _Mixture:
        several, then = at(training, sd), noise
        chance = np.tile(shares, (len(drawn), 1))
        for _ in range(4):
            chance = _chance(_joint(several, shares, then))
            # The likeliest would make the noise too small: one is drawn for each row.
            one = np.minimum((chance.cumsum(1) < drawn[:, None]).sum(1), len(NODES) - 1)
            then = fit_noise(np.stack(several)[one, np.arange(len(one))])
        return _Mixture(shares, then, chance)

    mixtures = [fitted(sd) for sd in JITTERS]
    gains = np.array([_mixed_gain(m, at(training, sd), noise).sum() for m, sd in zip(mixtures, JITTERS, strict=True)])
    best = int(gains.argmax())
    sd, inside = float(JITTERS[best]), JITTERS[gains > gains[best] - 2]
    interval = _interval(problem)
    constant = {"name": "jitter", "value": sd * interval, "unit": "s",
                "ci95": [float(inside.min()) * interval, float(inside.max()) * interval]}  # fmt: skip
    return _claim(
        "sampling_interval", training, heldout, lambda s: _mixed_gain(mixtures[best], at(s, sd), noise), rare=False,
        constants=[constant], outputs=_integrated(problem),
        shown=_spans(interval, at(training, sd), training, mixtures[best], EVEN),
        statement=f"Rows are not evenly spaced in time: the time that they span scatters by {sd * interval:.3f} s.",
    )  # fmt: skip


def _spans(
    interval: float, several: list[np.ndarray], training: _Sample, mixture: _Mixture, edges: Float[np.ndarray, " b"]
) -> Between:
    """The time that rows span, by how far the robot went in them."""
    axis = Axis("time a row spans, by the way covered [s]", interval, interval, edges)
    return Between(several, training.advance, mixture.shares, mixture.noise, axis)


def _interval(problem: Problem) -> float:
    """Time [s] that rows span by the positions' own advance, which need not be the nominal step."""
    return float(np.median(problem.scales.interval[problem.augmented.layout.integrates >= 0]))


def _integrated(problem: Problem) -> tuple[str, ...]:
    """Positions whose velocities are measured."""
    augmented = problem.augmented
    fields = augmented.simulator.schema.state
    return tuple(f.name for f, v in zip(fields, augmented.layout.integrates, strict=True) if v >= 0)


def _subsystems(layout: Layout) -> list[list[int]]:
    """Channels that may lose their commands together: all, or those of one body."""
    fields = layout.schema.command
    of_bodies = [[i for i, f in enumerate(fields) if f.body == body] for body in layout.bodies]
    every = list(range(len(fields)))
    return [every, *(channels for channels in of_bodies if channels and channels != every)]


def _lost_commands(problem: Problem, noise: Noise, training: _Sample, heldout: _Sample) -> Scatter | None:
    """Rows in which an earlier command acts instead of the one sent: of the subsystems, the one that gains most."""
    subsystems = _subsystems(problem.augmented.layout)
    found = [_held(problem, noise, training, heldout, i, channels) for i, channels in enumerate(subsystems)]
    return max((f for f in found if f is not None), key=lambda s: s.gain, default=None)


def _held(
    problem: Problem, noise: Noise, training: _Sample, heldout: _Sample, i: int, channels: list[int]
) -> Scatter | None:
    several = lambda s: [s.e, *s.held[i]]  # noqa: E731
    mixture = _mix(several(training), noise)
    minutes = len(training.e) * problem.scales.time_step / 60
    begins = float(mixture.chance[:, 1].sum())
    rate = begins / minutes
    length = problem.scales.time_step * float(mixture.shares[1:].sum() / max(mixture.shares[1], 1e-9))
    sd = np.sqrt(max(begins, 1.0)) / minutes
    constants = [
        {"name": "rate", "value": rate, "unit": "1/min", "ci95": [max(rate - 2 * sd, 0.0), rate + 2 * sd]},
        {"name": "length", "value": length, "unit": "s", "ci95": [length * 0.7, length * 1.4]},
    ]
    schema, names = problem.augmented.simulator.schema, _all(problem)
    bodies = {schema.command[c].body for c in channels}
    some = i > 0  # the first are all of them
    of = f" of {', '.join(sorted(bodies))}" if some else ""
    return _claim(
        "dropout", training, heldout, lambda s: _mixed_gain(mixture, several(s), noise), rare=True, constants=constants,
        shown=Between(several(training), training.e - training.held[i][0], mixture.shares, mixture.noise,
                      Axis("command that acts: 0 the one sent, 1 the last [-]", 0.0, 1.0, EVEN)),
        outputs=tuple(f.name for f in schema.state if f.body in bodies) if some else names,
        statement=f"Commands{of} are lost now and then ({rate:.1f} times a minute, for about {length:.2f} s), and the "
        "last one acts on.",
    )  # fmt: skip


def _all(problem: Problem) -> tuple[str, ...]:
    return tuple(f.name for f in problem.augmented.simulator.schema.state)
