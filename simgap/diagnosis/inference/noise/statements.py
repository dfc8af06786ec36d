"""Constants, intervals and statements of effects on the noise of single rows."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.inference.noise import row_mixture
from simgap.diagnosis.inference.noise.effect import Axis, Between, Widening
from simgap.diagnosis.inference.noise.row_mixture_em import Mixture
from simgap.diagnosis.inference.noise.sample import HELD, STALLS, Fitted, Robot, Sample, growths
from simgap.diagnosis.likelihood.student_t import Noise

SPANS = np.convolve([-1.5, -1.0, -0.5, 0.0, *STALLS, 8.0], [0.5, 0.5], "valid")
"""Edges of a picture's bins, one about each length of stall, in additional nominal intervals."""
EVEN = np.arange(-1.125, 2.2, 0.25)
"""The same with even bins, where no lengths are given."""


def _constant(sample: Sample, f: Fitted, name: str, unit: str, value_of: Callable[[Mixture], float]) -> dict[str, Any]:
    law = f.law(sample)
    interval = (row_mixture.burst_interval if law.bursts else row_mixture.interval)(
        law, sample.e, f.mixture, sample.starts, value_of
    )
    return {"name": name, "value": value_of(f.mixture), "unit": unit, "ci95": interval}


def late_said(robot: Robot, training: Sample, f: Fitted) -> dict[str, Any]:
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


def uneven_said(robot: Robot, training: Sample, f: Fitted) -> dict[str, Any]:
    jitter = _constant(training, f, "jitter", "s", lambda m: m.sd * robot.interval)
    nodes = np.linspace(-3, 3, 25)
    shares = np.exp(-0.5 * nodes**2)
    several = [training.e - f.mixture.sd * z * training.advance for z in nodes]
    return {
        "constants": [jitter], "outputs": robot.integrated,
        "shown": _spans(robot, several, training, shares / shares.sum(), f.mixture.noise, EVEN),
        "statement": "Rows are not evenly spaced in time: the time that they span has a standard deviation of "
        f"{jitter['value']:.2g} s.",
    }  # fmt: skip


def _spans(
    robot: Robot, several: list[np.ndarray], training: Sample, shares: np.ndarray, noise: Noise, edges: np.ndarray
) -> Between:
    """The time that rows span, inferred from the distance covered in them."""
    axis = Axis("time that a row spans, from the distance covered [s]", robot.interval, robot.interval, edges)
    return Between(several, training.advance, shares, noise, axis)


def _of_shifts(mixture: Mixture, number: int) -> Float[np.ndarray, " k"]:
    """Share of the rows that are not shifted, then the shares of those that are."""
    return np.append(mixture.shares[:-number].sum(), mixture.shares[-number:])


def wide_said(robot: Robot, training: Sample, f: Fitted) -> dict[str, Any]:
    growth = growths(robot)[f.about]
    columns = np.flatnonzero(growth.grows)
    names = tuple(robot.outputs[i] for i in columns)
    ratio = _constant(training, f, "ratio", "-", lambda m: 1 + m.slope)
    noise = Noise(f.mixture.noise.scale[columns], f.mixture.noise.dof[columns])
    return {
        "constants": [ratio], "outputs": names,
        "shown": Widening(training.e[:, columns], noise, growth.moving(training)[:, columns], ratio["value"]),
        "statement": f"{growth.says}: it is {ratio['value']:.1f} times as large when moving as at rest. This affects "
        "error bars, not means.",
    }  # fmt: skip


def lost_said(robot: Robot, training: Sample, f: Fitted) -> dict[str, Any]:
    last, held = len(HELD), training.held[f.about]
    rate = _constant(training, f, "rate", "1/min", lambda m: 60 / robot.time_step * float(m.shares[-last]))
    length = _constant(
        training, f, "length", "s",
        lambda m: robot.time_step * float(m.shares[-last:].sum() / max(m.shares[-last], 1e-9)),
    )  # fmt: skip
    low, high = length["ci95"]  # a burst may end anywhere within its last row
    length["ci95"] = [max(low - robot.time_step / 2, 0.0), high + robot.time_step / 2]
    of, outputs = robot.subsystems[f.about]
    axis = Axis("command that acts: 0 = the one sent, 1 = the previous one [-]", 0.0, 1.0, EVEN)
    shares = _of_shifts(f.mixture, last)
    return {
        "constants": [rate, length], "outputs": outputs,
        "shown": Between([training.e, *held], training.e - held[0], shares, f.mixture.noise, axis),
        "statement": f"Commands{of} are sometimes lost ({rate['value']:.1f} times a minute, for about "
        f"{length['value']:.2f} s). The last one received keeps acting.",
    }  # fmt: skip
