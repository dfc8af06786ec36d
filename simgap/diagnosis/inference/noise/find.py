"""Effects on the noise: noise that grows with motion, late rows, lost commands, oscillation at one frequency.

They leave the mean unchanged and are sought in the innovations of the best model of the mean. Each is a different
distribution of the innovations. It is claimed where it raises their likelihood, block by block, in training and in
held-out sessions.
"""

from simgap.diagnosis.config import LIKELY
from simgap.diagnosis.inference.noise.effect import NoiseEffect
from simgap.diagnosis.inference.noise.rows import of_rows
from simgap.diagnosis.inference.noise.spectral_line import stepping
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.diagnosis.likelihood.segments import Chunks


def noise_effects(problem: Problem, fit: Fit, unseen: Chunks, before: Chunks | None = None) -> list[NoiseEffect]:
    """All effects on the noise that training and held-out sessions support, except those that a baseline shows too."""
    effects = [of_rows(problem, fit, unseen), stepping(problem, fit, unseen, before)]
    if before is not None and effects[0] is not None:
        in_baseline = of_rows(problem, fit, before)
        if in_baseline is not None and in_baseline.id == effects[0].id:
            effects = effects[1:]
    return [effect for effect in effects if effect is not None and effect.odds[effect.id] >= LIKELY]
