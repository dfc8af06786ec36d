"""Power: for every effect and site, the smallest size that would have been found.

"Nothing is missing" is a claim about sizes. Smaller effects, and effects on what did not move, would not be found.
An effect that other parameters imitate is not found either, however long the recordings are: a gain of the force on a
body of unknown mass. It is no gap of the simulator, which describes the robot as well with those parameters.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from simgap.diagnosis.config import FEW, LEAST_BLOCK, LEAST_SHARE, POWER
from simgap.diagnosis.hypotheses.space import Hypothesis, unit_of
from simgap.diagnosis.inference.evidence.null_distribution import blocks
from simgap.diagnosis.inference.evidence.score_test import in_proportion
from simgap.diagnosis.inference.evidence.screening import Screened, Screening
from simgap.diagnosis.likelihood.problem import Problem

LARGEST = 10.0
"""Largest extrapolation of a law that is proportional to its constant, as a multiple of the size tested."""


class Visible(NamedTuple):
    """The smallest size of an effect at a site that would have been found.

    commands: those that the effect changes on the command path. size: of its constant [unit]; None if no size tried
    would have been found. usual_nats: largest gain among the usual sizes. imitated: whether it would gain enough if
    nothing else moved, but other parameters leave less than that, and less than `LEAST_SHARE`.
    """

    effect: str
    where: str
    commands: tuple[str, ...]
    constant: str
    size: float | None
    unit: str
    usual_nats: float
    imitated: bool


class Sensitivity(NamedTuple):
    """What could have been found.

    needed: nats that an effect must be able to gain. segments: number of independent segments in the fitted recordings.
    least_segments: minimum for a null distribution. least_rows: rows in that many segments.
    """

    visible: tuple[Visible, ...]
    needed: float
    segments: int
    least_segments: int
    least_rows: int

    @property
    def few(self) -> bool:
        """Whether there are too few independent segments for a null distribution."""
        return self.segments < self.least_segments

    @property
    def imitated_effects(self) -> list[str]:
        """Effects that other parameters imitate at every site."""
        others = {v.effect for v in self.visible if not v.imitated}
        return [effect for effect in dict.fromkeys(v.effect for v in self.visible) if effect not in others]

    @property
    def undetectable_effects(self) -> list[str]:
        """Effects that would not have been found at a usual size at any site where they are not imitated."""
        return _below(self.needed, ((v.effect, v.usual_nats) for v in self.visible if not v.imitated))

    @property
    def unexcited_channels(self) -> list[str]:
        """Commands on which no effect of a usual size would have been found: they hardly move."""
        return _below(self.needed, ((c, v.usual_nats) for v in self.visible if not v.imitated for c in v.commands))


def _below(needed: float, nats: Iterable[tuple[str, float]]) -> list[str]:
    """Names whose largest gain is below `needed`."""
    greatest: dict[str, float] = {}
    for name, gain in nats:
        greatest[name] = max(gain, greatest.get(name, 0.0))
    return [name for name, gain in greatest.items() if gain < needed]


def sensitivity(problem: Problem, screening: Screening, hypotheses: Sequence[Hypothesis]) -> Sensitivity:
    """From the first screening: what every effect at a single site would have gained at the sizes tested.

    The root of the score statistic of an effect that gains g nats is normal with mean sqrt(2 g) and variance one. So it
    exceeds the threshold's root with probability `POWER` if sqrt(2 g) is ndtri(POWER) standard deviations above that.
    """
    needed = 0.5 * float(np.sqrt(screening.threshold) + ndtri(POWER)) ** 2
    tested: dict[str, list[Screened]] = {}
    for s in screening.found:
        tested.setdefault(s.hypothesis.name, []).append(s)
    single = [c for c in hypotheses if len(c.sites) == 1]
    visible = tuple(_visible(problem, c, tested.get(c.name, ()), needed) for c in single)
    return Sensitivity(visible, needed, len(blocks(np.asarray(problem.chunks.counts))), FEW, FEW * LEAST_BLOCK)


def _visible(problem: Problem, hypothesis: Hypothesis, tested: Sequence[Screened], needed: float) -> Visible:
    """The size closest to zero that would have been found."""
    strong = [s for s in tested if s.unmoved >= needed]
    imitated = bool(strong) and all(s.power < min(needed, LEAST_SHARE * s.unmoved) for s in strong)
    amplitudes = [k for k, c in enumerate(hypothesis.effect.constants) if not c.shapes]
    visible = [(s.constant, size) for s in tested if not imitated and (size := _smallest(s, needed)) is not None]
    usual = max((s.power for s in tested), default=0.0)
    k, size = min(visible, key=lambda f: abs(f[1]), default=(amplitudes[0], None))
    constant = hypothesis.effect.constants[k]
    physical = None if size is None else float(constant.physical(size, hypothesis.sites[0], problem.scales))
    unit = unit_of(problem.augmented, hypothesis, constant)
    commands = hypothesis.channels if hypothesis.effect.place in ("command", "filter") else ()
    return Visible(hypothesis.effect.id, hypothesis.where, commands, constant.name, physical, unit, usual, imitated)


def _smallest(s: Screened, needed: float) -> float | None:
    """The smallest internal value that would have been found, according to one test; None if it gives none.

    The gain of a law that is proportional to its constant grows with the constant's square, so it can be extrapolated.
    """
    if in_proportion(s.hypothesis, s.constant):
        return s.tested * float(np.sqrt(needed / s.power)) if s.power * LARGEST**2 >= needed else None
    return s.tested if s.power >= needed else None
