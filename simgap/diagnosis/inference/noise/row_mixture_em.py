"""Expectation maximisation of row mixtures [Dempster, Laird & Rubin 1977]."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import isotonic_regression
from scipy.special import gammaln

from simgap.diagnosis.likelihood.student_t import DOFS, LEAST, Noise

WIDE = (2.0, 4.0, 8.0)
"""Scales of wide rows, relative to the plain one."""
_WIDTHS = np.array([1.0, *WIDE], np.float32)[:, None, None]
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
    slope, ln sd. sd: updated, of the amplitude. part, squares: for every width and shift, its probability and the
    squared innovation in scales.
    """

    density: Float[np.ndarray, " n"]
    chance: Float[np.ndarray, "n k"]
    spread: Float[np.ndarray, " s"]
    weight: Float[np.ndarray, " s"]
    by_scale: Float[np.ndarray, "n s"]
    by_slope: Float[np.ndarray, " n"]
    by_sd: Float[np.ndarray, " n"]
    sd: float
    part: Float[np.ndarray, "_ s n"]
    squares: Float[np.ndarray, "_ s n"]


def without_plain(shares: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Shares without the plain component."""
    shares = np.append(0.0, shares[1:])
    return shares / shares.sum()


def _log_t(
    z2: Float[np.ndarray, "... s n"], noise: Noise, dof: Float[np.ndarray, "s 1"]
) -> Float[np.ndarray, "... s n"]:
    d = noise.dof
    constant = gammaln((d + 1) / 2) - gammaln(d / 2) - 0.5 * np.log(d * np.pi) - np.log(noise.scale)
    out = np.log1p(z2 / dof)
    out *= -(dof + 1) / 2
    out += constant[:, None].astype(np.float32)
    return out


def _over_outputs(x: Float[np.ndarray, "... s n"]) -> Float[np.ndarray, "... n"]:
    """Sums over the outputs, as a matrix product: with so few of them it takes half of the time."""
    return np.ones(x.shape[-2], x.dtype) @ x


def _over_rows(x: Float[np.ndarray, "_ s n"]) -> Float[np.ndarray, " s"]:
    """Sums over the widths and shifts, and then over the rows, in 64 bits."""
    return x.sum(0).sum(-1, dtype=np.float64)


def expectation(law: Law, e: Float[np.ndarray, "n s"], mixture: Mixture) -> _Expected:
    # Outputs lead, and there are few calls, with all widths and shifts at once: both halve the time.
    noise, (n, s), widths = mixture.noise, e.shape, len(_WIDTHS)
    dof = noise.dof.astype(np.float32)[:, None]
    width = np.ones((s, 1)) if law.moving is None else 1 + mixture.slope * law.moving.T
    unit = (noise.scale[:, None] * width).astype(np.float32)
    z = np.divide(e.T, unit, order="C").astype(np.float32)
    along = np.divide(law.shifts.transpose(0, 2, 1), unit, order="C").astype(np.float32)
    a, curvature = _amplitudes(z, along, dof, mixture) if law.free else (np.ones((len(along), 1), np.float32), None)
    squares = np.concatenate([z / _WIDTHS, z - a[:, None] * along])
    squares *= squares
    log_density = _log_t(squares, noise, dof)
    shifted = _over_outputs(log_density[widths:])
    if curvature is not None:
        shifted -= 0.5 * (((a - mixture.mean) / mixture.sd) ** 2 + np.log(mixture.sd**2 * curvature))
        squares[widths:] += along**2 / curvature[:, None]  # the variance of the amplitude
    inside = np.zeros((len(law.groups), s), np.float32)
    for row, group in zip(inside, law.groups, strict=True):
        row[group] = 1
    wide = inside @ (log_density[1:widths] - np.log(_WIDTHS[1:])) + (1 - inside) @ log_density[0]
    columns = np.vstack([_over_outputs(log_density[:1]), wide.swapaxes(0, 1).reshape(-1, n), shifted])
    with np.errstate(divide="ignore"):
        joint = columns.astype(np.float64) + np.log(mixture.shares)[:, None]
    peak = joint.max(0)
    chance = np.exp(joint - peak)
    normaliser = chance.sum(0)
    chance /= normaliser
    density = peak + np.log(normaliser) - _over_outputs(np.log(width))
    part = _responsibilities(chance.astype(np.float32), inside)
    # For every output: r (u z^2 - 1), with u = (dof + 1) / (dof + z^2).
    u = part * (dof + 1)
    u /= dof + squares
    weight = _over_rows(u)
    u *= squares
    by_scale = u.sum(0) - 1
    spread = n + by_scale.sum(-1, dtype=np.float64)
    by_slope = np.zeros(n)
    if law.moving is not None:
        by_slope = _over_outputs(by_scale * (mixture.slope * law.moving.T / width))
    by_sd, sd = np.zeros(n), mixture.sd
    if curvature is not None:
        r = chance[-len(law.shifts) :]
        squared = r * ((a.astype(np.float64) - mixture.mean) ** 2 + 1 / curvature.astype(np.float64))
        sd = max(float(np.sqrt(squared.sum() / max(float(r.sum()), 1e-9))), NARROWEST)
        by_sd = (squared / mixture.sd**2 - r).sum(0)
    return _Expected(density, chance.T, spread, weight, by_scale.T, by_slope, by_sd, sd, part, squares)


def _amplitudes(
    z: Float[np.ndarray, "s n"], d: Float[np.ndarray, "k s n"], dof: Float[np.ndarray, "s 1"], mixture: Mixture
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k n"]]:
    """The most likely amplitude of every row along each direction, and the curvature there [Laplace]."""
    prior, mean = np.float32(1 / mixture.sd**2), np.float32(mixture.mean)
    a, curvature = np.full((len(d), z.shape[1]), mean), np.full((len(d), z.shape[1]), prior)
    scaled = d * (dof + 1)
    for _ in range(NEWTON):
        weighted = scaled / (dof + (z - a[:, None] * d) ** 2)
        curvature = _over_outputs(weighted * d) + prior
        a = (_over_outputs(weighted * z) + prior * mean) / curvature
    return a, curvature


def _responsibilities(chance: Float[np.ndarray, "k n"], inside: Float[np.ndarray, "g s"]) -> Float[np.ndarray, "_ s n"]:
    """For every output and row, the probability of each width, then of each shift. inside: outputs of each group."""
    (groups, s), n, widths = inside.shape, chance.shape[1], len(_WIDTHS)
    shifts = chance[1 + groups * len(WIDE) :]
    part = np.empty((widths + len(shifts), s, n), np.float32)
    part[1:widths] = inside.T @ chance[1 : len(chance) - len(shifts)].reshape(groups, -1, n).swapaxes(0, 1)
    part[widths:] = shifts[:, None]
    part[0] = np.maximum(1 - part[1:].sum(0), 0)
    return part


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
    dof, scale = noise.dof.astype(np.float32)[:, None], noise.scale
    for _ in range(2):
        squares = x.squares * ((before.scale / scale) ** 2).astype(np.float32)[:, None]
        u = x.part / (dof + squares)
        weight = _over_rows(u)
        u *= squares
        scale = _scale(scale, _over_rows(u), weight)
    noise, ratio = Noise(scale, noise.dof), ((before.scale / scale) ** 2).astype(np.float32)[:, None]
    return noise, _over_rows(x.part * _log_t(x.squares * ratio, noise, dof))
