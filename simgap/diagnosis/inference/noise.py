"""Effects that do not move the mean: scatter that grows with motion, rows that come late, lost commands, stepping.

They are looked for in what the best model of the mean leaves over: each is another distribution of the innovations,
and is claimed where it makes them likelier, block by block, in training and in held-out sessions.
"""

from simgap.diagnosis.config import LIKELY
from simgap.diagnosis.inference.noise_effect import NoiseEffect
from simgap.diagnosis.inference.noise_rows import of_rows
from simgap.diagnosis.inference.spectral_line import stepping
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.diagnosis.likelihood.segments import Chunks


def noise_effects(problem: Problem, fit: Fit, unseen: Chunks, before: Chunks | None = None) -> list[NoiseEffect]:
    """All effects on the scatter that training and held-out sessions agree on, but for what a baseline has as well."""
    found = [of_rows(problem, fit, unseen), stepping(problem, fit, unseen, before)]
    if before is not None and found[0] is not None:
        known = of_rows(problem, fit, before)
        if known is not None and known.id == found[0].id:
            found = found[1:]
    return [f for f in found if f is not None and f.odds[f.id] >= LIKELY]
