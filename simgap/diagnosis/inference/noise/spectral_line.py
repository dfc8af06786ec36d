"""Oscillation at one frequency, as stepping causes: a peak in the spectrum of the innovations."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import gammaincc, stdtrit

from simgap.diagnosis.config import LINE_LEVEL, REQUIRED_OF_NOISE, STRONGER
from simgap.diagnosis.inference.fitting.model import cost
from simgap.diagnosis.inference.noise.effect import OTHER, NoiseEffect, Spectrum
from simgap.diagnosis.inference.search.alternatives import compared
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, raw_innovations
from simgap.diagnosis.likelihood.segments import Chunks, counted, rows_of
from simgap.effects.sites import turning

SEGMENT = 64
"""Rows per segment of the periodograms."""
POWER = float((np.hanning(SEGMENT) ** 2).sum())
"""Power of the Hann window."""
NO_POWER = 1e-18


class _Pieces(NamedTuple):
    """Sessions in Hann-windowed segments: raw innovations and commands, each minus its mean."""

    e: Float[np.ndarray, "S t s"]
    command: Float[np.ndarray, "S t u"]

    def power(self) -> Float[np.ndarray, "f s"]:
        """Power spectrum, summed over segments."""
        return (np.abs(np.fft.rfft(self.e, axis=1)) ** 2).sum(0) / POWER


def stepping(problem: Problem, fit: Fit, unseen: Chunks, before: Chunks | None) -> NoiseEffect | None:
    """A peak in the periodogram of an output's innovations, above the level of its neighbours.

    The force and rate of a robot's steps depend on its path. So a peak is new only if it exceeds the strongest one of
    the baseline, at whatever frequency that lies.
    """
    pieces = _pieces(problem, fit)
    power, count = pieces.power(), len(pieces.e)
    peak = _peak(power, count)
    if peak is None:
        return None
    k, best, gain, amplitude, above = peak
    if before is not None and amplitude < STRONGER * _strongest_amplitude(problem._replace(chunks=before), fit, best):
        return None
    heldout = _pieces(problem._replace(chunks=unseen), fit)
    if not len(heldout.e):
        return None
    heldout_gain = float(_line_gain(*_power_at(heldout, k, best), above).sum())
    _, level = _power_at(pieces, k, best)
    odds = _odds(pieces, k, best, above)
    line = line_of(pieces.e[:, :, best], k, level)
    if heldout_gain <= 0 or odds is None or not line.amplitude[0] > 0:
        return None
    field, hertz = problem.augmented.simulator.schema.outputs[best], 1 / (SEGMENT * problem.scales.time_step)
    factor = 1 / _share_in_innovations(problem, fit, best, line.amplitude[0], hertz * line.frequency[0])
    unit = field.unit
    if field.kind != "velocity":
        factor, unit = 2 * np.pi * hertz * line.frequency[0] * factor, f"{unit}/s"
    constants = [
        {"name": name, "value": scale * value, "unit": of, "ci95": [scale * low, scale * high]}
        for name, scale, of, (value, low, high) in
        (("amplitude", factor, unit, line.amplitude), ("frequency", hertz, "Hz", line.frequency))
    ]  # fmt: skip
    layout = problem.augmented.layout
    what, like = "joint" if layout.jointed else "body", ", as stepping does" if turning(layout) else ""
    amplitude, frequency = (c["value"] for c in constants)
    sentence = (
        f"The {what} shakes periodically at {frequency:.2f} Hz, with an amplitude of about {amplitude:.2g} {unit}"
    )
    shown = Spectrum(power[:, best], level * count, k, count, hertz, field)
    return NoiseEffect(
        "gait_oscillation", False, constants, (field.name,), f"{sentence} ({field.name}){like}.", gain, heldout_gain,
        odds, shown,
    )  # fmt: skip


def _pieces(problem: Problem, fit: Fit) -> _Pieces:
    raw = evaluate(problem._replace(whiten=np.eye(len(problem.whiten))), fit.v, fit.groups, fit.noise).e
    chunks, rows = problem.chunks, rows_of(problem.chunks)
    command = np.asarray(chunks.command)[:, :-1][np.asarray(chunks.counts)]
    window, series = np.hanning(SEGMENT)[:, None], np.hstack([raw, command])
    segments = [
        window * (piece - piece.mean(0))
        for s in np.unique(rows.session)
        for of_session in [series[rows.session == s]]
        for piece in np.split(of_session[: len(of_session) // SEGMENT * SEGMENT], len(of_session) // SEGMENT or 1)
        if len(piece)
    ]
    pieces = np.array(segments).reshape(len(segments), SEGMENT, series.shape[1])
    return _Pieces(pieces[:, :, : raw.shape[1]], pieces[:, :, raw.shape[1] :])


def _power_at(pieces: _Pieces, k: int, output: int) -> tuple[Float[np.ndarray, " S"], float]:
    """Power of every segment at a bin, and the level around it."""
    level = _level_around(pieces.power()[:, output])[k] / len(pieces.e)
    return np.abs(np.fft.rfft(pieces.e[:, :, output], axis=1)[:, k]) ** 2 / POWER, max(float(level), NO_POWER)


def _line_gain(power: Float[np.ndarray, " S"], level: float, above: float) -> Float[np.ndarray, " S"]:
    """Gain of every segment, if its power is exponential with a mean of `above` times the level [Whittle 1953]."""
    return power / level * (1 - 1 / above) - np.log(above)


def _odds(pieces: _Pieces, k: int, output: int, above: float) -> dict[str, float] | None:
    """Probability of an oscillation, against the level around and against a response to a command that the model lacks.

    None where the oscillation is not the best of these, or where it rests on a single segment.
    """
    power, level = _power_at(pieces, k, output)
    density = {"gait_oscillation": _line_gain(power, level, above), OTHER: np.zeros(len(power))}
    constants = {"gait_oscillation": 2, OTHER: 0}
    if np.sort(density["gait_oscillation"])[:-1].sum() < REQUIRED_OF_NOISE:
        return None
    x = np.fft.rfft(pieces.e[:, :, output], axis=1)[:, k]
    for u in np.fft.rfft(pieces.command, axis=1)[:, k].T:
        # Predict every segment by the response of the others to this command; the remainder is at the level.
        us, xs = np.abs(u) ** 2, np.conj(u) * x
        response = (xs.sum() - xs) / np.maximum(us.sum() - us, NO_POWER)
        driven = (power - np.abs(x - response * u) ** 2 / POWER) / level
        if driven.sum() > density[OTHER].sum():
            density[OTHER] = driven
    score = {name: d.sum() - cost(constants[name], len(power)) for name, d in density.items()}
    lead = max(score, key=lambda name: score[name])
    if lead == OTHER:
        return None
    starts = np.arange(len(power))
    return compared(density, constants, starts, lead, float(density[lead].sum()))


class Line(NamedTuple):
    """Amplitude, and frequency in bins, each with the ends of its 95 % interval."""

    amplitude: tuple[float, float, float]
    frequency: tuple[float, float, float]


def line_of(pieces: Float[np.ndarray, "S t"], k: int, level: float) -> Line:
    """A wave near a bin, with its own phase in every windowed segment, over noise of the given level.

    Frequency: where the summed power is greatest. Intervals: Student's t of the spread over segments [White 1982].
    """
    time = np.arange(pieces.shape[1])
    angles = -2j * np.pi * time / len(time)

    def at(f: Float[np.ndarray, " m"]) -> Float[np.ndarray, "S m"]:
        return np.abs(pieces @ np.exp(angles[:, None] * f)) ** 2 / POWER

    tried = np.linspace(k - 1, k + 1, 401)
    best = int(np.clip(at(tried).sum(0).argmax(), 1, len(tried) - 2))
    step = tried[1] - tried[0]
    low, middle, high = at(tried[best - 1 : best + 2]).T
    slope, bend = (high - low) / (2 * step), ((high - 2 * middle + low) / step**2).sum()
    f = float(np.clip(tried[best] - slope.sum() / bend, tried[0], tried[-1]) if bend < 0 else tried[best])
    t = float(stdtrit(len(pieces) - 1, 0.975))
    width = t * float(np.sqrt((slope**2).sum() * len(slope) / (len(slope) - 1))) / max(abs(float(bend)), NO_POWER)
    squares = 4 * (at(np.array([f]))[:, 0] - level) * POWER / np.hanning(len(time)).sum() ** 2
    mean, error = float(squares.mean()), t * float(squares.std(ddof=1) / np.sqrt(len(squares)))
    amplitude = [float(np.sqrt(max(a, 0.0))) for a in (mean, mean - error, mean + error)]
    return Line((amplitude[0], amplitude[1], amplitude[2]), (f, f - width, f + width))


def _share_in_innovations(problem: Problem, fit: Fit, output: int, amplitude: float, hertz: float) -> float:
    """Share of an output's wave that remains in its innovations; its measurements let the filter predict the rest."""
    chunks = problem.chunks
    wave = amplitude * jnp.sin(2 * jnp.pi * hertz * chunks.time_s)
    shaken = problem._replace(chunks=chunks._replace(state=chunks.state.at[..., output].add(wave)))
    added = counted(chunks, raw_innovations(shaken, fit.v) - raw_innovations(problem, fit.v))[:, output]
    return float(np.sqrt(2 * np.mean(added**2)) / amplitude)


def _strongest_amplitude(problem: Problem, fit: Fit, output: int) -> float:
    """Amplitude of an output's strongest peak."""
    pieces = _pieces(problem, fit)
    power, segments = pieces.power(), len(pieces.e)
    inside = range(3, len(power) - 2)
    return max(_amplitude(power[:, output], segments, k) for k in inside) if segments else 0.0


def _level_around(power: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
    """Level around every frequency: the greater of the medians over the bins 3 to 8 below and 3 to 8 above.

    So a steeply falling spectrum, as of slow drifts, has no peak.
    """
    away = np.arange(3, 9)
    index = np.arange(len(power))[:, None, None] + np.stack([-away, away])
    inside = (index >= 1) & (index < len(power))
    values = np.where(inside, power[np.clip(index, 0, len(power) - 1)], np.nan)
    # Close to an end of the spectrum one side has no such bins; its outermost bin replaces them.
    values[:, 0, 0] = np.where(inside[:, 0].any(1), values[:, 0, 0], power[1])
    values[:, 1, 0] = np.where(inside[:, 1].any(1), values[:, 1, 0], power[-1])
    return np.nanmedian(values, axis=2).max(1)


def _peak(power: Float[np.ndarray, "f v"], segments: int) -> tuple[int, int, float, float, float] | None:
    """(frequency bin, output, gain [nats], amplitude, power over level) of the most significant peak, if there is one.

    A segment's power is exponentially distributed, with the level around as its mean, or a multiple of that level.
    """
    if segments < 3:
        return None
    best = None
    for j in range(power.shape[1]):
        level = _level_around(power[:, j]) / segments
        ratio = power[:, j] / np.maximum(level, NO_POWER)
        k = 3 + int(ratio[3:-2].argmax())
        # In a flat spectrum the ratio is Gamma distributed; the level is itself an estimate, hence half the segments.
        chance = gammaincc(segments / 2, ratio[k] / 2) * power.size
        if chance < LINE_LEVEL and (best is None or ratio[k] > best[4] * segments):
            above = float(ratio[k] / segments)
            gain = float(segments * (above - 1 - np.log(above)))
            best = (k, j, gain, _amplitude(power[:, j], segments, k), above)
    return best if best and best[2] > REQUIRED_OF_NOISE else None


def _amplitude(power: Float[np.ndarray, " f"], segments: int, k: int) -> float:
    """Amplitude of a wave, from the power above the level around it, at its bin and the two adjacent ones."""
    level = _level_around(power)[k]
    return float(np.sqrt(4 * (power[k - 1 : k + 2] - level).clip(0).sum() / (segments * SEGMENT)))
