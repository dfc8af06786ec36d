"""How much the true form could gain on held-out data, in nats, and the magnitude that gains a wanted amount.

The robot is run without noise, with the effect on. To that the plain robot is refitted: its 24 parameters by
Gauss-Newton, and how eagerly its filter follows what is measured. What its innovations then hold besides noise is what
the true form foretells and the best plain robot does not. Both are Gaussian filters under the noise of the case; the
plain one may also refit the covariance of its innovations, so that the gain of the true form is, axis by axis,

    gain = N/2 (log det(S(K) + D) - log det S(K*))     minimised over the filter's gain K

with S(K) the innovations' covariance by noise alone, K* the Kalman gain, and D the mean square of what noise does not
explain in N rows. It is an expectation: no draw of noise is in it. The strength is the share of it that the sessions
held out have, a quarter.

Chance that belongs to the effect (when commands are lost, where the floor is uneven) counts as known to the true form:
an upper bound there. Noise that grows with motion moves no mean; its strength is the gain of the known variances over
the best constant one.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from concealed.form import Array, Form, Size
from concealed.forms.measuring import Shaking
from concealed.plain import POSITION, VELOCITY, Noise, Observer, Robot, innovations, observer, refit, robot
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


class Plain(NamedTuple):
    """What is refitted: the plain robot, the filters that it may have, its noise, and the size of its recordings."""

    robot: Robot
    filters: Observer
    noise: Noise
    size: Size


def strengths(plain: Plain, forms: Sequence[Form], run: Run, magnitude: Array) -> Array:
    """Strength [M], in nats, at every magnitude [M, F]."""
    of, by, noise, size = plain
    tape, copies, filters = run(forms, magnitude), len(magnitude), len(by.gain)
    split = lambda a: np.repeat(a.reshape(copies, size.sessions, *a.shape[1:]), filters, axis=0)  # noqa: E731
    each = Observer(*(np.tile(a, (copies, 1, 1, 1)) for a in by))
    _, e = refit(of, each, split(tape.measured), split(tape.command), rounds=3)
    pairs = np.stack([e[..., POSITION], e[..., VELOCITY]], axis=-1)
    rows = pairs.shape[1] * pairs.shape[2]
    unexplained = np.einsum("gstai,gstaj->gaij", pairs, pairs) / rows
    unexplained = unexplained.reshape(copies, filters, 6, 2, 2)
    worst = np.linalg.slogdet(by.cov + unexplained)[1].min(1)
    gain = 0.5 * rows * (worst - np.linalg.slogdet(by.cov[0])[1]).sum(1)
    for i, form in enumerate(forms):
        if isinstance(form, Shaking):
            true = tape.true.reshape(copies, size.sessions, *tape.true.shape[1:])
            gain = gain + _of_variances(form, magnitude[:, i], by, noise, true)
    return HELD_OUT * gain


def _of_variances(form: Shaking, m: Array, by: Observer, noise: Noise, true: Array) -> Array:
    """Gain [M] of knowing the variance of every innovation over knowing the best constant one."""
    total = np.zeros(len(m))
    on = [i for i, name in enumerate((*POSITION, *VELOCITY)) if _moved(form, int(name))]
    for j, mj in enumerate(m):
        growth = form.growth_at(true[j].reshape(-1, 12), mj)
        for i in on:
            axis, part = i % 6, i // 6
            variance = by.cov[0, axis, part, part]
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


UNLIKE = Robot(np.full((1, 6), 0.3), np.zeros((1, 12)), np.ones((1, 6)))
"""Where the refit of a robot that is not the plain one begins."""
UNSURE = Noise(np.full(12, 1e-2), np.full(12, 1e-2))
"""Noise of a filter for it."""


def of_change(state: Array, command: Array, state_after: Array, command_after: Array) -> float:
    """What is new in a machine since, in nats on held-out sessions: how much less probable its rows are, to the plain
    robot fitted to the rows before, than those were; innovations Gaussian on either side. Nil where nothing changed."""
    by = observer(UNLIKE, UNSURE)
    flat, e = refit(UNLIKE, by, state[None], command[None])
    many = robot(np.repeat(flat, len(state_after), axis=0))
    new = innovations(many, by, state_after, command_after)
    rows = new.shape[0] * new.shape[1]
    return max(0.0, HELD_OUT * 0.5 * rows * float((_volume(new) - _volume(e[0])).sum()))


def _volume(e: Array) -> Array:
    """Log determinant of the innovations' covariance of every axis [6]."""
    pairs = np.stack([e[..., POSITION], e[..., VELOCITY]], axis=-1).reshape(-1, 6, 2)
    return np.linalg.slogdet(np.einsum("nai,naj->aij", pairs, pairs) / len(pairs))[1]
