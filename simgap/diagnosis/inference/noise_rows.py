"""Rows that scatter more than others: noise that grows with motion, rows that come late, lost commands.

Each is another distribution of the innovations, row by row (`row_mixture`), and they compete: with each other, with
rows that are wide in no direction, and with misfit along the directions in which lost commands would move the rows.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from simgap.diagnosis.inference import row_mixture
from simgap.diagnosis.inference.alternatives import compared
from simgap.diagnosis.inference.noise_effect import OTHER, REQUIRED, NoiseEffect
from simgap.diagnosis.inference.noise_sample import HELD, STALLS, Fitted, Robot, Sample, robot_of, sample_of
from simgap.diagnosis.inference.noise_statements import late_said, lost_said, uneven_said, wide_said
from simgap.diagnosis.inference.row_mixture_em import Law, Mixture
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.diagnosis.likelihood.student_t import Noise, log_density

SURE = 3.5
"""Standard deviations, over blocks of rows, by which the gain of what acts in all rows must exceed zero."""
ODDEST = 3
"""Blocks of rows without which the gain of what acts in few rows must suffice: it has to happen again and again."""
RARE, COMMON = 0.02, 0.3
"""Shares of rows with which the fit of a component begins, of what acts in few rows and in many."""
SPREAD = 0.3
"""Standard deviation of an amplitude, and slope of the noise by the motion, with which their fits begin."""


def of_rows(problem: Problem, fit: Fit, unseen: Chunks) -> NoiseEffect | None:
    """The best word for rows that scatter more than others, if it is better than noise without a name."""
    training, heldout = (sample_of(problem._replace(chunks=c), fit) for c in (problem.chunks, unseen))
    return explained(robot_of(problem), fit.noise, training, heldout)


def explained(robot: Robot, noise: Noise, training: Sample, heldout: Sample) -> NoiseEffect | None:
    """The same, of samples."""
    groups = (np.arange(len(robot.outputs)), *(b for b in robot.bodies.values() if 0 < len(b) < len(robot.outputs)))
    plain = _fit(OTHER, lambda s: Law(groups, s.e[:0, None]), training, row_mixture.of_plain(noise, groups))
    independent = log_density(training.e, noise).sum(1)
    named = [*_late_rows(plain, training), *_motion(robot, plain, training), *_lost_commands(plain, training)]
    named = [f for f in named if _certain(f, plain, independent, training.starts)]
    # Where the noise of one of these fits better without its law as well, that was no merit of the law.
    number = len(plain.mixture.shares)
    noises = [row_mixture.without_shifts(f.mixture, len(f.mixture.shares) - number) for f in named]
    plain = max((plain, *(_fit(OTHER, plain.law, training, m) for m in noises)), key=_score)
    named = [f for f in named if _certain(f, plain, independent, training.starts)]
    if not named:
        return None
    held = {f.about for f in named if f.id == "dropout"}
    others = [plain, *(m for i in held for m in _misfit(plain, training, i))]
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
    seen = [row_mixture.density(f.law(heldout), heldout.e, f.mixture) for f in (lead, plain)]
    held_gain = float((seen[0] - seen[1]).sum())
    if held_gain <= 0:
        return None
    said = {
        "dropout": lost_said,
        "motion_dependent_noise": wide_said,
        "sampling_interval": late_said if lead.rare else uneven_said,
    }
    return NoiseEffect(
        id=lead.id, rare=lead.rare, gain=float(gain.sum()), heldout_gain=held_gain, odds=odds,
        **said[lead.id](robot, training, lead),
    )  # fmt: skip


def _score(f: Fitted) -> float:
    """Log-likelihood less log n / 2 a constant."""
    return float(f.density.sum()) - 0.5 * f.constants * np.log(max(len(f.density), 1))


def _certain(f: Fitted, plain: Fitted, independent: Float[np.ndarray, " n"], starts: np.ndarray) -> bool:
    """Whether a hypothesis gains more than chance over noise without a name, blocks of rows being independent.

    What is rare has its gain in few blocks, whose spread would be all of it: it must happen again and again. Wide rows
    may share the credit for each of these, so there it counts against noise that is independent in every output.
    """
    gain = f.density - plain.density
    if f.rare:
        again = np.sort(np.add.reduceat(f.density - independent, starts))[:-ODDEST].sum()
        return bool(gain.sum() > REQUIRED and again > REQUIRED)
    per_block = np.add.reduceat(gain, starts)
    return bool(gain.sum() > REQUIRED and gain.sum() > SURE * np.sqrt((per_block**2).sum()))


def _fit(
    name: str, law: Callable[[Sample], Law], sample: Sample, start: Mixture, constants: int = 0, **more: Any
) -> Fitted:
    mixture, density = row_mixture.fitted(law(sample), sample.e, start)
    return Fitted(name, law, mixture, density, constants, **more)


def _groups(plain: Fitted, sample: Sample) -> tuple[Int[np.ndarray, " g"], ...]:
    return plain.law(sample).groups


def _late_rows(plain: Fitted, sample: Sample) -> list[Fitted]:
    """Rows in which the robot moved on for longer than the nominal interval, or for an uneven time, all positions
    alike."""
    if not sample.advance.any():
        return []
    groups = _groups(plain, sample)
    late = lambda s: Law(groups, STALLS[:, None, None] * s.advance)  # noqa: E731
    uneven = lambda s: Law(groups, s.advance[None], free=True, everywhere=True)  # noqa: E731
    begun = row_mixture.with_shifts(plain.mixture, np.full(len(STALLS), RARE))
    every = row_mixture.with_shifts(plain.mixture, np.array([1 - COMMON]))._replace(mean=0.0, sd=SPREAD)
    stalls = _fit("sampling_interval", late, sample, begun, rare=True)
    stalls = stalls._replace(constants=int((stalls.mixture.shares[-len(STALLS) :] * len(sample.e) >= 1).sum()))
    return [stalls, _fit("sampling_interval", uneven, sample, every, 1)]


def _motion(robot: Robot, plain: Fitted, sample: Sample) -> list[Fitted]:
    """Noise of all outputs by all motion, or of a body's by its own."""
    groups, found = _groups(plain, sample), []
    for k, columns in enumerate([np.arange(len(robot.outputs)), *robot.bodies.values()]):
        if k and not 0 < len(columns) < len(robot.outputs):
            continue
        own = np.isin(np.arange(len(robot.outputs)), columns)
        law = lambda s, k=k, own=own: Law(groups, s.e[:0, None], moving=s.moving[:, [k]] * own)  # noqa: E731
        found.append(_fit("motion_dependent_noise", law, sample, plain.mixture._replace(slope=SPREAD), 1, about=k))
    return found


def _held(groups: tuple[Int[np.ndarray, " g"], ...], i: int, free: bool) -> Callable[[Sample], Law]:
    return lambda s: Law(groups, s.e - s.held[i], bursts=True, free=free)


def _lost_commands(plain: Fitted, sample: Sample) -> list[Fitted]:
    """Rows in which an earlier command acts instead of the one sent: of the subsystems, the one that gains most.

    By the whole way from one to the other, or about it: an estimate that follows the state late sees less, or more.
    """
    begun = row_mixture.with_shifts(plain.mixture, np.full(len(HELD), RARE))
    groups, number = _groups(plain, sample), range(len(sample.held))
    exact = [_fit("dropout", _held(groups, i, False), sample, begun, about=i) for i in number]
    best = max(exact, key=_score)
    law, start = _held(groups, best.about, True), best.mixture._replace(sd=SPREAD)
    return [_fit("dropout", law, sample, start, len(HELD) + 1, rare=True, about=best.about)]


def _misfit(plain: Fitted, sample: Sample, i: int) -> list[Fitted]:
    """Rows that are moved along the way from the command sent to an earlier one, but not about all of it.

    In many rows about none of it, either way; or in some about half: as where the response to commands differs from
    the model's.
    """
    law = _held(_groups(plain, sample), i, True)
    many, few = np.array([COMMON, *[RARE] * (len(HELD) - 1)]), np.full(len(HELD), RARE)
    begun = [
        row_mixture.with_shifts(plain.mixture, s)._replace(mean=m, sd=SPREAD) for m, s in ((0.0, many), (0.5, few))
    ]
    return [_fit(OTHER, law, sample, start, len(HELD) + 1) for start in begun]
