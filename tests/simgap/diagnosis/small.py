"""Planted recordings of one small size, so that all tests share what is compiled for it; and what is found in them."""

import numpy as np
from planted import SPOT, recordings

from simgap.diagnosis.config import EXPLAINED, LIKELY
from simgap.diagnosis.inference import explain as explanation
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.search.alternatives import Member
from simgap.diagnosis.inference.search.posterior import differs_from_zero
from simgap.diagnosis.likelihood.filter import filtered
from simgap.diagnosis.likelihood.problem import Problem
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import Chunks, cut
from simgap.diagnosis.likelihood.variables import Variables
from simgap.effects import CATALOGUE
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales
from simgap.types import Recording, Sessions

SESSIONS, ROWS = 4, 200
"""Three sessions to fit are 15 chunks, the fourth is 5: both are filled up to 16."""
RICH = 4
"""A seed with which all sessions move base and arm along all axes."""
KEYS = {effect.key: effect for effect in CATALOGUE}


def acting(key: str, constants: tuple[float, ...], sites: tuple[int, ...] = (0,)) -> dict[tuple[str, int, int], float]:
    """An effect's internal constants at some sites, for `planted.recordings`."""
    return {(key, k, site): c for k, c in enumerate(constants) for site in sites}


def sessions(constants: dict, seed: int = 0, noise: float = 1.0, **more) -> tuple[list[Recording], list[Recording]]:
    """Three sessions to fit, one held out."""
    recorded = recordings(constants, seed, SESSIONS, ROWS, noise, **more)
    return recorded[:-1], recorded[-1:]


def problem(training: list[Recording]) -> Problem:
    return Problem(SPOT, measure(SPOT, training), cut(training, 1 / 15), np.eye(12))


def innovations(augmented: Augmented, scales: Scales, v: Variables, chunks: Chunks) -> np.ndarray:
    """Innovations [C, t, s] of one value of the variables."""
    e = filtered(augmented, scales, v, chunks, v.phi).innovations
    return np.where(np.asarray(chunks.counts)[..., None], e, 0.0)


def explain(training: list[Recording], heldout: list[Recording]) -> Explanation:
    """The best explanation, with the lines of the search in pytest's output."""
    return explanation.explain(SPOT.simulator, Sessions(training, heldout), np.random.default_rng(0), print)


def assert_explains(found: Explanation, member: Member) -> None:
    """An effect explains its outputs: likely, with a law that need not bend and constants that differ from zero."""
    assert member.odds[member.hypothesis.effect.id] >= LIKELY
    assert member.gain >= EXPLAINED * (member.gain + member.misfit)
    assert differs_from_zero(found.problem, found.fit, member.hypothesis, found.sd)
    assert found.named_share(member) >= EXPLAINED
