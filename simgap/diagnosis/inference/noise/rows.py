"""Effects on the noise of single rows: noise that grows with motion, late rows, lost commands.

Each is a distribution of the innovations, row by row (`row_mixture`). They compete with each other, with rows that are
wide without a direction, and with misfit along the directions in which lost commands would move the rows.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from simgap.diagnosis.config import REQUIRED_OF_NOISE, SET_ASIDE, SURE_OF_NOISE
from simgap.diagnosis.inference.fitting.model import cost
from simgap.diagnosis.inference.noise import row_mixture
from simgap.diagnosis.inference.noise.effect import OTHER, NoiseEffect
from simgap.diagnosis.inference.noise.row_mixture_em import Law, Mixture
from simgap.diagnosis.inference.noise.sample import HELD, STALLS, Fitted, Robot, Sample, growths, robot_of, sample_of
from simgap.diagnosis.inference.noise.statements import late_said, lost_said, uneven_said, wide_said
from simgap.diagnosis.inference.search.alternatives import compared
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.diagnosis.likelihood.student_t import Noise, log_density

RARE, COMMON = 0.02, 0.3
"""Initial share of a component, for effects on few rows and on many."""
SPREAD = 0.3
"""Initial standard deviation of an amplitude, and initial slope of the noise with the motion."""


def of_rows(problem: Problem, fit: Fit, unseen: Chunks) -> NoiseEffect | None:
    """The best effect on the noise of single rows, if it beats unnamed noise."""
    training, heldout = (sample_of(problem._replace(chunks=c), fit) for c in (problem.chunks, unseen))
    return explained(robot_of(problem), fit.noise, training, heldout)


def explained(robot: Robot, noise: Noise, training: Sample, heldout: Sample) -> NoiseEffect | None:
    """The same, from samples."""
    groups = (np.arange(len(robot.outputs)), *(b for b in robot.bodies.values() if 0 < len(b) < len(robot.outputs)))
    plain = _fit(OTHER, lambda s: Law(groups, s.e[:0, None]), training, row_mixture.of_plain(noise, groups))
    independent = log_density(training.e, noise).sum(1)
    named = [*_late_rows(plain, training), *_motion_noise(robot, plain, training), *_lost_commands(plain, training)]
    named = [f for f in named if _significant(f, plain, independent, training.starts)]
    # The noise of such a fit may be better even without its law. That gain is not due to the law.
    number = len(plain.mixture.shares)
    noises = [row_mixture.without_shifts(f.mixture, len(f.mixture.shares) - number) for f in named]
    plain = max((plain, *(_fit(OTHER, plain.law, training, m) for m in noises)), key=_score)
    named = [f for f in named if _significant(f, plain, independent, training.starts)]
    if not named:
        return None
    subsystems = {f.about for f in named if f.id == "dropout"}
    others = [plain, *(m for i in subsystems for m in _misfit(plain, training, i))]
    best = {f.id: f for f in sorted([*others, *named], key=_score)}
    lead = max(best.values(), key=_score)
    gain = lead.density - plain.density
    if lead.id == OTHER:
        return None
    odds = compared(
        {k: f.density for k, f in best.items()},
        {k: f.constants for k, f in best.items()},
        training.starts,
        lead.id,
        float(gain.sum()),
    )
    densities = [row_mixture.density(f.law(heldout), heldout.e, f.mixture) for f in (lead, plain)]
    heldout_gain = float((densities[0] - densities[1]).sum())
    if heldout_gain <= 0:
        return None
    describe = {
        "dropout": lost_said,
        "motion_dependent_noise": wide_said,
        "sampling_interval": late_said if lead.rare else uneven_said,
    }
    return NoiseEffect(
        id=lead.id, rare=lead.rare, gain=float(gain.sum()), heldout_gain=heldout_gain, odds=odds,
        **describe[lead.id](robot, training, lead),
    )  # fmt: skip


def _score(f: Fitted) -> float:
    """Log-likelihood minus 0.5 log n per constant."""
    return float(f.density.sum()) - cost(f.constants, max(len(f.density), 1))


def _significant(f: Fitted, plain: Fitted, independent: Float[np.ndarray, " n"], starts: np.ndarray) -> bool:
    """Whether a hypothesis gains more than chance over unnamed noise, with blocks of rows as independent units.

    A rare effect gains in few blocks, so its standard deviation over blocks is as large as its gain. It must occur
    repeatedly instead. Wide rows may share the credit for each occurrence, so these gains are taken over noise that is
    independent in every output.
    """
    gain = f.density - plain.density
    if f.rare:
        repeated = np.sort(np.add.reduceat(f.density - independent, starts))[:-SET_ASIDE].sum()
        return bool(gain.sum() > REQUIRED_OF_NOISE and repeated > REQUIRED_OF_NOISE)
    per_block = np.add.reduceat(gain, starts)
    return bool(gain.sum() > REQUIRED_OF_NOISE and gain.sum() > SURE_OF_NOISE * np.sqrt((per_block**2).sum()))


def _fit(
    name: str, law: Callable[[Sample], Law], sample: Sample, start: Mixture, constants: int = 0, **more: Any
) -> Fitted:
    mixture, density = row_mixture.fitted(law(sample), sample.e, start)
    return Fitted(name, law, mixture, density, constants, **more)


def _groups(plain: Fitted, sample: Sample) -> tuple[Int[np.ndarray, " g"], ...]:
    return plain.law(sample).groups


def _late_rows(plain: Fitted, sample: Sample) -> list[Fitted]:
    """Rows in which all positions advance for longer than the nominal interval, or for an uneven time."""
    if not sample.advance.any():
        return []
    groups = _groups(plain, sample)
    late = lambda s: Law(groups, STALLS[:, None, None] * s.advance)  # noqa: E731
    uneven = lambda s: Law(groups, s.advance[None], free=True, everywhere=True)  # noqa: E731
    stalls_start = row_mixture.with_shifts(plain.mixture, np.full(len(STALLS), RARE))
    uneven_start = row_mixture.with_shifts(plain.mixture, np.array([1 - COMMON]))._replace(mean=0.0, sd=SPREAD)
    stalls = _fit("sampling_interval", late, sample, stalls_start, rare=True)
    stalls = stalls._replace(constants=int((stalls.mixture.shares[-len(STALLS) :] * len(sample.e) >= 1).sum()))
    return [stalls, _fit("sampling_interval", uneven, sample, uneven_start, 1)]


def _motion_noise(robot: Robot, plain: Fitted, sample: Sample) -> list[Fitted]:
    groups, start = _groups(plain, sample), plain.mixture._replace(slope=SPREAD)
    laws = [lambda s, g=g: Law(groups, s.e[:0, None], moving=g.moving(s)) for g in growths(robot)]
    return [_fit("motion_dependent_noise", law, sample, start, 1, about=k) for k, law in enumerate(laws)]


def _held_law(groups: tuple[Int[np.ndarray, " g"], ...], i: int, free: bool) -> Callable[[Sample], Law]:
    return lambda s: Law(groups, s.e - s.held[i], bursts=True, free=free)


def _lost_commands(plain: Fitted, sample: Sample) -> list[Fitted]:
    """Rows in which an earlier command acts instead of the one sent, for the subsystem that gains most.

    They are shifted by the full difference between the two, or about that: a late state estimate shows less, or more.
    """
    exact_start = row_mixture.with_shifts(plain.mixture, np.full(len(HELD), RARE))
    groups, subsystems = _groups(plain, sample), range(len(sample.held))
    exact = [_fit("dropout", _held_law(groups, i, False), sample, exact_start, about=i) for i in subsystems]
    best = max(exact, key=_score)
    law, start = _held_law(groups, best.about, True), best.mixture._replace(sd=SPREAD)
    return [_fit("dropout", law, sample, start, len(HELD) + 1, rare=True, about=best.about)]


def _misfit(plain: Fitted, sample: Sample, i: int) -> list[Fitted]:
    """Rows shifted towards an earlier command, but not by about the full difference.

    Either many rows by about zero, with either sign; or some by about half. This happens where the response to commands
    differs from the model's.
    """
    law = _held_law(_groups(plain, sample), i, True)
    many, few = np.array([COMMON, *[RARE] * (len(HELD) - 1)]), np.full(len(HELD), RARE)
    starts = [
        row_mixture.with_shifts(plain.mixture, s)._replace(mean=m, sd=SPREAD) for m, s in ((0.0, many), (0.5, few))
    ]
    return [_fit(OTHER, law, sample, start, len(HELD) + 1) for start in starts]
