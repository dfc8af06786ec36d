"""What the recordings could have shown: for every effect and site the smallest size that would have been found.

"Nothing is missing" is a claim about sizes. Below them, and where nothing moved, the recordings are silent.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from simgap.diagnosis.config import BLOCK, FEW, POWER
from simgap.diagnosis.hypotheses.space import Hypothesis, unit_of
from simgap.diagnosis.inference.null_distribution import blocks
from simgap.diagnosis.inference.score_test import Screened, Screening, in_proportion
from simgap.diagnosis.likelihood.problem import Problem

LARGEST = 10.0
"""Times the usual size, up to which a law in proportion to its constant is extrapolated."""


class Visible(NamedTuple):
    """The smallest size of an effect at a site that would have been found.

    commands: those that the effect changes on their way. size: of its constant [unit]; None where no size that was
    tried would have been. usual_nats: what the most visible of the usual sizes would have gained.
    """

    effect: str
    where: str
    commands: tuple[str, ...]
    constant: str
    size: float | None
    unit: str
    usual_nats: float


class Sensitivity(NamedTuple):
    """What could have been found. needed: nats that an effect must be able to gain. segments: independent pieces of the
    fitted recordings; least_segments: with fewer, chance itself cannot be judged. least_rows: the rows of so many.
    """

    visible: tuple[Visible, ...]
    needed: float
    segments: int
    least_segments: int
    least_rows: int

    @property
    def few(self) -> bool:
        """Whether there are too few independent pieces to judge what chance does."""
        return self.segments < self.least_segments

    @property
    def undetectable_effects(self) -> list[str]:
        """Effects of which no usual size would have been found at any site."""
        return _below(self.needed, ((v.effect, v.usual_nats) for v in self.visible))

    @property
    def unexcited_channels(self) -> list[str]:
        """Commands of which no usual change would have been found, of any kind: they hardly move."""
        return _below(self.needed, ((c, v.usual_nats) for v in self.visible for c in v.commands))


def _below(needed: float, nats: Iterable[tuple[str, float]]) -> list[str]:
    """The names whose greatest gain is below what is needed."""
    greatest: dict[str, float] = {}
    for name, gain in nats:
        greatest[name] = max(gain, greatest.get(name, 0.0))
    return [name for name, gain in greatest.items() if gain < needed]


def sensitivity(problem: Problem, screening: Screening, hypotheses: Sequence[Hypothesis]) -> Sensitivity:
    """By the first screening: what every effect at a single site would have gained at the sizes that were tested.

    The statistic of an effect that gains g nats is normal about sqrt(2 g), of variance one; it is found with the chance
    `POWER` where sqrt(2 g) exceeds the root of the screening's threshold by as many deviations.
    """
    needed = 0.5 * float(np.sqrt(screening.threshold) + ndtri(POWER)) ** 2
    tested: dict[str, list[Screened]] = {}
    for s in screening.found:
        tested.setdefault(s.hypothesis.name, []).append(s)
    single = [c for c in hypotheses if len(c.sites) == 1]
    visible = tuple(_visible(problem, c, tested.get(c.name, ()), needed) for c in single)
    return Sensitivity(visible, needed, len(blocks(np.asarray(problem.chunks.counts))), FEW, FEW * BLOCK)


def _visible(problem: Problem, hypothesis: Hypothesis, tested: Sequence[Screened], needed: float) -> Visible:
    """Of the sizes that would have been found the one closest to no effect."""
    amplitudes = [k for k, c in enumerate(hypothesis.effect.constants) if not c.shapes]
    found = [(s.constant, size) for s in tested if (size := _smallest(s, needed)) is not None]
    k, size = min(found, key=lambda f: abs(f[1]), default=(amplitudes[0], None))
    constant = hypothesis.effect.constants[k]
    physical = None if size is None else float(constant.physical(size, hypothesis.sites[0], problem.scales))
    usual = max((s.power for s in tested), default=0.0)
    unit = unit_of(problem.augmented, hypothesis, constant)
    commands = hypothesis.channels if hypothesis.effect.place in ("command", "filter") else ()
    return Visible(hypothesis.effect.id, hypothesis.where, commands, constant.name, physical, unit, usual)


def _smallest(s: Screened, needed: float) -> float | None:
    """The smallest internal value that would have been found, by one test; None where the test leads to none.

    The gain of a law in proportion to its constant grows with the square of it, and it need not have been tested there.
    """
    if in_proportion(s.hypothesis, s.constant):
        return s.tested * float(np.sqrt(needed / s.power)) if s.power * LARGEST**2 >= needed else None
    return s.tested if s.power >= needed else None
