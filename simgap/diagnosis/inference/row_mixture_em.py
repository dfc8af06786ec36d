"""Expectation maximisation of row mixtures [Dempster, Laird & Rubin 1977]."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import isotonic_regression
from scipy.special import gammaln

from simgap.diagnosis.likelihood.student_t import DOFS, LEAST, Noise

WIDE = (2.0, 4.0, 8.0)
"""Scales of wide rows, relative to the plain one."""
RENEWED = 4
"""Steps between updates of the degrees of freedom."""
NEWTON = 4
"""Newton steps to a row's most likely amplitude."""
NARROWEST = 0.02
"""Minimum standard deviation of an amplitude."""


class Law(NamedTuple):
    """The law to fit. groups: outputs that are wide together. shifts: directions along which rows may be shifted.

    bursts: shifts are those of the first row of an event, the second ..., so no share exceeds the previous one. free:
    the amplitude of shifts is normal about the mixture's mean; otherwise it is 1. everywhere: no row is plain. moving:
    how the noise of each output grows (scale times 1 + slope * moving).
    """

    groups: tuple[Int[np.ndarray, " g"], ...]
    shifts: Float[np.ndarray, "k n s"]
    bursts: bool = False
    free: bool = False
    everywhere: bool = False
    moving: Float[np.ndarray, "n s"] | None = None


class Mixture(NamedTuple):
    """Fitted constants: shares of the components (plain, wide of each group and width, shifts), noise, mean and
    standard deviation of the amplitude, slope."""

    shares: Float[np.ndarray, " k"]
    noise: Noise
    mean: float = 1.0
    sd: float = 0.0
    slope: float = 0.0


class _Expected(NamedTuple):
    """Expectations over the component of every row, given the row and the constants.

    density: ln p(e_n). chance [n k]: probability of each component. spread [s], weight [s]: sums over rows whose ratio
    updates the noise's squared scale. by_scale [n s], by_slope, by_sd [n]: derivatives of ln p(e_n) by ln scale, ln
    slope, ln sd. sd: updated, of the amplitude. parts: for every width and shift, its probability and the squared
    innovation in scales.
    """

    density: Float[np.ndarray, " n"]
    chance: Float[np.ndarray, "n k"]
    spread: Float[np.ndarray, " s"]
    weight: Float[np.ndarray, " s"]
    by_scale: Float[np.ndarray, "n s"]
    by_slope: Float[np.ndarray, " n"]
    by_sd: Float[np.ndarray, " n"]
    sd: float
    parts: list[tuple[np.ndarray, np.ndarray]]


def without_plain(shares: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Shares without the plain component."""
    shares = np.append(0.0, shares[1:])
    return shares / shares.sum()


def _log_t(z2: Float[np.ndarray, "n s"], noise: Noise, dof: Float[np.ndarray, " s"]) -> Float[np.ndarray, "n s"]:
    constant = gammaln((dof + 1) / 2) - gammaln(dof / 2) - 0.5 * np.log(dof * np.pi) - np.log(noise.scale)
    return (constant - (dof + 1) / 2 * np.log1p(z2 / dof)).astype(np.float32)


def _over_columns(x: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
    """Sums over the columns, as a matrix product: with so few columns it takes a third of the time."""
    return x @ np.ones(x.shape[1], x.dtype)


def _over_rows(x: Float[np.ndarray, "n s"]) -> Float[np.ndarray, " s"]:
    """Sums over the rows, in 64 bits."""
    return np.ones(len(x)) @ x


def expectation(law: Law, e: Float[np.ndarray, "n s"], mixture: Mixture) -> _Expected:
    noise, (n, s) = mixture.noise, e.shape
    dof = noise.dof.astype(np.float32)
    width = np.ones((1, s)) if law.moving is None else 1 + mixture.slope * law.moving
    unit = (noise.scale * width).astype(np.float32)
    z = (e / unit).astype(np.float32)
    widths = np.array([1.0, *WIDE], np.float32)
    squares = [(z / w) ** 2 for w in widths]
    log_density = [_log_t(z2, noise, dof) - np.log(w) for z2, w in zip(squares, widths, strict=True)]
    columns = [_over_columns(log_density[0])]
    for group in law.groups:
        inside = np.isin(np.arange(s), group).astype(np.float32)
        columns += [x @ inside + log_density[0] @ (1 - inside) for x in log_density[1:]]
    amplitudes = []
    for d in law.shifts:
        d = (d / unit).astype(np.float32)
        a, curvature = _amplitudes(z, d, dof, mixture) if law.free else (np.ones(n, np.float32), None)
        z2 = (z - a[:, None] * d) ** 2
        extra = 0.0
        if curvature is not None:
            extra = -0.5 * (((a - mixture.mean) / mixture.sd) ** 2 + np.log(mixture.sd**2 * curvature))
        columns.append(_over_columns(_log_t(z2, noise, dof)) + extra)
        if curvature is not None:  # the variance of the amplitude
            z2 = z2 + d**2 / curvature[:, None]
        squares.append(z2)
        amplitudes.append((a, curvature))
    with np.errstate(divide="ignore"):
        joint = np.column_stack(columns).astype(np.float64) + np.log(mixture.shares)
    peak = joint.max(1)
    chance = np.exp(joint - peak[:, None])
    normaliser = _over_columns(chance)
    total = peak + np.log(normaliser)
    chance /= normaliser[:, None]
    total = total - _over_columns(np.broadcast_to(np.log(width), (n, s)))
    responsibilities = _responsibilities(law, chance.astype(np.float32), s)
    # For every output: r (u z^2 - 1), with u = (dof + 1) / (dof + z^2).
    weight, by_scale = np.zeros(s), np.full((n, s), -1.0, np.float32)
    for r, z2 in zip(responsibilities, squares, strict=True):
        u = r * (dof + 1) / (dof + z2)
        weight += _over_rows(u)
        u *= z2
        by_scale += u
    spread = n + _over_rows(by_scale)
    by_slope = np.zeros(n)
    if law.moving is not None:
        by_slope = _over_columns(by_scale * (mixture.slope * law.moving / width))
    by_sd, sd = np.zeros(n), mixture.sd
    if law.free:
        r = chance[:, -len(law.shifts) :]
        a, curvature = (np.stack(x, axis=1).astype(np.float64) for x in zip(*amplitudes, strict=True))
        squared = r * ((a - mixture.mean) ** 2 + 1 / curvature)
        sd = max(float(np.sqrt(squared.sum() / max(float(r.sum()), 1e-9))), NARROWEST)
        by_sd = (squared / mixture.sd**2 - r).sum(1)
    parts = list(zip(responsibilities, squares, strict=True))
    return _Expected(total, chance, spread, weight, by_scale, by_slope, by_sd, sd, parts)


def _amplitudes(
    z: Float[np.ndarray, "n s"], d: Float[np.ndarray, "n s"], dof: Float[np.ndarray, " s"], mixture: Mixture
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The most likely amplitude of every row along a direction, and the curvature there [Laplace]."""
    prior = np.float32(1 / mixture.sd**2)
    a, curvature = np.full(len(z), mixture.mean, np.float32), np.full(len(z), prior)
    for _ in range(NEWTON):
        weighted = d * (dof + 1) / (dof + (z - a[:, None] * d) ** 2)
        curvature = _over_columns(weighted * d) + prior
        a = (_over_columns(weighted * z) + prior * np.float32(mixture.mean)) / curvature
    return a, curvature


def _responsibilities(law: Law, chance: Float[np.ndarray, "n k"], outputs: int) -> list[Float[np.ndarray, "n _"]]:
    """For every output and row, the probability of each width, then of each shift."""
    n, wide = len(chance), len(law.groups) * len(WIDE)
    widths: list[np.ndarray] = [np.zeros((n, outputs), np.float32) for _ in WIDE]
    for g, group in enumerate(law.groups):
        for k, r in enumerate(widths):
            r[:, group] += chance[:, [1 + g * len(WIDE) + k]]
    shifts = [chance[:, [k]] for k in range(1 + wide, chance.shape[1])]
    return [np.maximum(1 - sum(widths) - sum(shifts), 0), *widths, *shifts]


def maximisation(law: Law, mixture: Mixture, x: _Expected, renew: bool) -> Mixture:
    shares, noise = x.chance.mean(0), mixture.noise
    noise = Noise(_scale(noise.scale, x.spread, x.weight), noise.dof)
    if renew:
        noise = _dof(noise, mixture.noise, x)
    slope = mixture.slope
    if law.bursts:
        first = len(shares) - len(law.shifts)
        shares[first:] = isotonic_regression(shares[first:], increasing=False).x
    if law.moving is not None:
        # A step of Berndt, Hall, Hall & Hausman [1974] in ln slope, with the average noise kept constant.
        grows = law.moving.any(0)
        usual = x.by_scale[:, grows].sum(1, dtype=np.float64)
        along = float(x.by_slope @ usual) / max(float(usual @ usual), 1e-9)
        score = x.by_slope - along * usual
        step = float(np.clip(score.sum() / max(float(score @ score), 1e-9), -0.5, 0.5))
        slope *= np.exp(step)
        noise = Noise(noise.scale * np.where(grows, np.exp(-along * step), 1.0), noise.dof)
    return Mixture(shares, noise, mixture.mean, x.sd, slope)


def _scale(
    before: Float[np.ndarray, " s"], spread: Float[np.ndarray, " s"], weight: Float[np.ndarray, " s"]
) -> Float[np.ndarray, " s"]:
    return np.maximum(before * np.sqrt(np.maximum(spread, 0.0) / np.maximum(weight, 1e-9)), LEAST)


def _dof(noise: Noise, before: Noise, x: _Expected) -> Noise:
    """Per output, the best of its degrees of freedom and the next lower and higher ones, each with its own scale."""
    at = np.array([int(np.abs(DOFS - d).argmin()) for d in noise.dof])
    candidates = [_rescaled(Noise(noise.scale, DOFS[np.clip(at + k, 0, len(DOFS) - 1)]), before, x) for k in (0, -1, 1)]
    best = np.stack([value for _, value in candidates]).argmax(0)
    scale, dof = (np.stack([n[i] for n, _ in candidates])[best, np.arange(len(at))] for i in (0, 1))
    return Noise(scale, dof)


def _rescaled(noise: Noise, before: Noise, x: _Expected) -> tuple[Noise, Float[np.ndarray, " s"]]:
    """Noise with the scale that fits its degrees of freedom, and its expected log-density."""
    dof, scale = noise.dof.astype(np.float32), noise.scale
    for _ in range(2):
        ratio = ((before.scale / scale) ** 2).astype(np.float32)
        weight, spread = np.zeros(len(scale)), np.zeros(len(scale))
        for r, z2 in x.parts:
            u = r / (dof + z2 * ratio)
            weight += _over_rows(u)
            u *= z2 * ratio
            spread += _over_rows(u)
        scale = _scale(scale, spread, weight)
    noise, ratio = Noise(scale, noise.dof), ((before.scale / scale) ** 2).astype(np.float32)
    parts = [_over_rows(r * _log_t(z2 * ratio, noise, dof)) for r, z2 in x.parts]
    return noise, np.sum(parts, axis=0)
