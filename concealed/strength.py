"""How much the true form could gain on held-out data, in nats, and the magnitude that gains a wanted amount.

The robot is run without noise, with the effect on; the plain robot's 24 parameters are refitted to that by
Gauss-Newton under the noise of the case, and its whitened innovations are then what the true form foretells and the
best plain robot does not. Under the known noise the true form's expected gain in log-likelihood is half their squared
sum: the divergence between the two, with no draw of noise in it. Of all rows' gain, the share of the sessions held out
(a quarter) is the strength.

    strength = 1/4 1/2 sum_t |W (y_t - y_t(best plain robot))|^2

Chance that belongs to the effect (when commands are lost, where the floor is uneven) counts as known to the true form:
an upper bound there. Noise that grows with motion moves no mean; its strength is the gain of the known variances over
the best constant one.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from concealed.form import Array, Form, Size
from concealed.forms.measuring import Shaking
from concealed.plain import POSITION, VELOCITY, Noise, Observer, Robot, refit
from concealed.robot import Tape

HELD_OUT = 0.25
"""Share of the sessions that are held out."""
FIRST, TRIES, NEAR = 0.03, 9, 0.2
"""First factor on a form's scale, most that are tried, and how near in logarithm is near enough."""

Run = Callable[[Sequence[Form], Array], Tape]
"""Runs the case without noise, forms at magnitudes [M, F], M copies side by side."""


class Found(NamedTuple):
    """Factor on the forms' scales, and the strength [nats] it has."""

    factor: float
    nats: float


def strengths(
    of: Robot, by: Observer, noise: Noise, size: Size, forms: Sequence[Form], run: Run, magnitude: Array
) -> Array:
    """Strength [M] at every magnitude [M, F]."""
    tape, copies = run(forms, magnitude), len(magnitude)
    split = lambda a: a.reshape(copies, size.sessions, *a.shape[1:])  # noqa: E731
    _, white = refit(of, by, split(tape.measured), split(tape.command), rounds=1)
    gain = 0.5 * (white**2).sum((1, 2, 3, 4))
    for i, form in enumerate(forms):
        if isinstance(form, Shaking):
            gain = gain + _of_variances(form, magnitude[:, i], by, noise, split(tape.true))
    return HELD_OUT * gain


def _of_variances(form: Shaking, m: Array, by: Observer, noise: Noise, true: Array) -> Array:
    """Gain [M] of knowing the variance of every innovation over knowing the best constant one."""
    total = np.zeros(len(m))
    on = [i for i, name in enumerate((*POSITION, *VELOCITY)) if _moved(form, int(name))]
    for j, mj in enumerate(m):
        form.m = np.full(true.shape[1] * true.shape[2], mj)
        growth = form.growth(true[j].reshape(-1, 12))
        for i in on:
            axis, part = i % 6, i // 6
            variance = by.cov[axis, part, part]
            output = (POSITION, VELOCITY)[part][axis]
            rest = max(variance - noise.measured[output] ** 2, 0.0)
            each = rest + (noise.measured[output] * growth) ** 2
            total[j] += 0.5 * len(each) * (np.log(each.mean()) - np.log(each).mean())
    return total


def _moved(form: Shaking, output: int) -> bool:
    return (output < 6) == (form.body == "base")


def reach_for(target: float, evaluate: Callable[[float], float]) -> Found:
    """The factor in (0, 1] whose strength is near the target; its greatest where that is out of reach.

    Secants in the logarithms (strength goes with the square of what is small), kept within what is known to be too weak
    and too strong.
    """
    tried: dict[float, float] = {}
    factor, low, high = FIRST, 0.0, np.inf
    for _ in range(TRIES):
        nats = tried[factor] = max(evaluate(factor), 1e-9)
        if abs(np.log(nats / target)) < NEAR or (factor >= 1.0 and nats < target):
            break
        low, high = (max(low, factor), high) if nats < target else (low, min(high, factor))
        wanted = factor * float(np.clip(np.sqrt(target / nats), 1 / 20, 20))
        # What has a threshold does not go with the square: halve the way where the guess leaves what is known.
        inside = low * 1.02 < wanted < high / 1.02
        middle = float(np.sqrt(max(low, 1e-3 * min(high, 1.0)) * min(high, 1.0)))
        factor = min(wanted if inside else middle, 1.0)
    best = min(tried, key=lambda f: abs(np.log(tried[f] / target)))
    return Found(best, tried[best])
