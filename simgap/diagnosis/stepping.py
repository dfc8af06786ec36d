"""Shaking at one frequency, as stepping has it: a peak in the spectrum of what the model of the mean leaves over."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import gammaincc

from simgap.diagnosis.fit import Fit, Problem, counted, evaluate, raw_innovations
from simgap.diagnosis.innovations import Chunks
from simgap.diagnosis.scatter_claim import OWED, Scatter, Spectrum
from simgap.diagnosis.when import rows_of

SEGMENT = 64
"""Rows of the periodograms in which stepping is looked for."""
LEVEL = 1e-3
"""Chance of a peak as certain where nothing shakes."""
NO_POWER = 1e-18
STRONGER = 1.5
"""Times the amplitude of any in a baseline that shaking must have to be new."""


def stepping(problem: Problem, fit: Fit, unseen: Chunks, before: Chunks | None) -> Scatter | None:
    """A peak in the periodogram of an output's innovations, over the level of its neighbours.

    A robot that steps does so with the force and at the rate that its way asks for: what is new exceeds the strongest
    peak of the baseline, wherever that lies.
    """
    power, count = _periodogram(problem, fit)
    found = _peak(power, count)
    if found is None:
        return None
    k, best, gain, amplitude, above = found
    if before is not None and amplitude < STRONGER * _strongest(problem._replace(chunks=before), fit, best):
        return None
    there, segments = _periodogram(problem._replace(chunks=unseen), fit)
    if not segments:
        return None
    ratio = there[k, best] * segments / max(_neighbours(there[:, best])[k], NO_POWER)
    held = float(ratio * (1 - 1 / above) - segments * np.log(above))
    if held <= 0:
        return None
    field, hertz = problem.augmented.simulator.schema.state[best], k / (SEGMENT * problem.scales.time_step)
    width, unit = 0.5 / (SEGMENT * problem.scales.time_step), field.unit
    amplitude /= _left_of_wave(problem, fit, best, amplitude, hertz)
    if field.kind != "velocity":
        amplitude, unit = 2 * np.pi * hertz * amplitude, f"{unit}/s"
    constants = [
        {"name": "amplitude", "value": amplitude, "unit": unit, "ci95": [0.7 * amplitude, 1.4 * amplitude]},
        {"name": "frequency", "value": hertz, "unit": "Hz", "ci95": [hertz - width, hertz + width]},
    ]
    said = f"The body shakes periodically, at {hertz:.2f} Hz with about {amplitude:.2g} {unit} ({field.name})"
    level = float(_neighbours(power[:, best])[k])
    shown = Spectrum(power[:, best], level, k, count, hertz / k, field)
    return Scatter("gait_oscillation", False, constants, (field.name,), f"{said}, as stepping does.", gain, held, shown)


def _periodogram(problem: Problem, fit: Fit) -> tuple[Float[np.ndarray, "f s"], int]:
    """Summed power of raw innovations in segments of sessions, and the number of segments."""
    raw = evaluate(problem._replace(whiten=np.eye(len(problem.whiten))), fit.v, fit.groups, fit.noise).e
    rows = rows_of(problem.chunks)
    total, count = np.zeros((SEGMENT // 2 + 1, raw.shape[1])), 0
    window = np.hanning(SEGMENT)[:, None]
    for s in np.unique(rows.session):
        mine = raw[rows.session == s]
        for first in range(0, len(mine) - SEGMENT + 1, SEGMENT):
            piece = mine[first : first + SEGMENT]
            total += np.abs(np.fft.rfft(window * (piece - piece.mean(0)), axis=0)) ** 2 / (window**2).sum()
            count += 1
    return total, count


def _left_of_wave(problem: Problem, fit: Fit, output: int, amplitude: float, hertz: float) -> float:
    """Share of an output's wave that is left in its innovations: some of it is foretold by what is measured of it."""
    chunks = problem.chunks
    wave = amplitude * jnp.sin(2 * jnp.pi * hertz * chunks.time_s)
    shaken = problem._replace(chunks=chunks._replace(state=chunks.state.at[..., output].add(wave)))
    added = counted(chunks, raw_innovations(shaken, fit.v) - raw_innovations(problem, fit.v))[:, output]
    return float(np.sqrt(2 * np.mean(added**2)) / amplitude)


def _strongest(problem: Problem, fit: Fit, output: int) -> float:
    """Amplitude of an output's strongest peak."""
    power, segments = _periodogram(problem, fit)
    inside = range(3, len(power) - 2)
    return max(_amplitude(power[:, output], segments, k) for k in inside) if segments else 0.0


def _neighbours(power: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
    """Level around every frequency: the greater of the medians at 3 to 8 bins' distance below and above.

    Of a spectrum that falls steeply, as slow drifts have it, no part is a peak.
    """
    away = np.arange(3, 9)
    index = np.arange(len(power))[:, None, None] + np.stack([-away, away])
    inside = (index >= 1) & (index < len(power))
    values = np.where(inside, power[np.clip(index, 0, len(power) - 1)], np.nan)
    # Close to an end of the spectrum there is one side only; below, its lowest bins.
    values[:, 0, 0] = np.where(inside[:, 0].any(1), values[:, 0, 0], power[1])
    values[:, 1, 0] = np.where(inside[:, 1].any(1), values[:, 1, 0], power[-1])
    return np.nanmedian(values, axis=2).max(1)


def _peak(power: Float[np.ndarray, "f v"], segments: int) -> tuple[int, int, float, float, float] | None:
    """(frequency bin, output, gain [nats], amplitude, times the level) of the most certain peak, if it is certain.

    A segment's power is exponentially distributed: at the level around, or at so many times that level.
    """
    if segments < 3:
        return None
    best = None
    for j in range(power.shape[1]):
        level = _neighbours(power[:, j]) / segments
        ratio = power[:, j] / np.maximum(level, NO_POWER)
        k = 3 + int(ratio[3:-2].argmax())
        # Of a flat spectrum the ratio is Gamma distributed; the level itself is an estimate, hence half the segments.
        chance = gammaincc(segments / 2, ratio[k] / 2) * power.size
        if chance < LEVEL and (best is None or ratio[k] > best[4] * segments):
            above = float(ratio[k] / segments)
            gain = float(segments * (above - 1 - np.log(above)))
            best = (k, j, gain, _amplitude(power[:, j], segments, k), above)
    return best if best and best[2] > OWED else None


def _amplitude(power: Float[np.ndarray, " f"], segments: int, k: int) -> float:
    """Of a wave at a bin and those beside it, by its power over the level around it."""
    level = _neighbours(power)[k]
    return float(np.sqrt(4 * (power[k - 1 : k + 2] - level).clip(0).sum() / (segments * SEGMENT)))
