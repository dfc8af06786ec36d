"""The verdict: which names stand, whether something else is missing, and whether the recordings suffice to say so."""

from typing import Any, NamedTuple

import numpy as np

from simgap.diagnosis.config import EXPLAINED, LARGE, LIKELY, WELL_DETERMINED
from simgap.diagnosis.inference.alternatives import Member
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.posterior import differs_from_zero
from simgap.diagnosis.inference.whiteness import touched
from simgap.diagnosis.validation import scores
from simgap.diagnosis.validation.scores import Judged, Judgement
from simgap.diagnosis.validation.sensitivity import Sensitivity


class Verdict(NamedTuple):
    """What is concluded.

    verdict: as in diagnosis.json. named, possible: of each member, whether it is named, and whether it could be.
    something_else: whether more is missing than what is named. share: of the black box's one-step gain that the members
    make. beaten_at: horizons [rows] at which a black box surely beats all others on held-out sessions. worse_at: those
    at which the second model of a pair is worse than the first. parameters_moved: whether held-out sessions gain by
    other parameters alone.
    """

    verdict: str
    named: tuple[bool, ...]
    possible: tuple[bool, ...]
    something_else: bool
    share: dict[str, Any] | None
    beaten_at: tuple[int, ...]
    worse_at: dict[tuple[str, str], list[int]]
    parameters_moved: bool


def conclude(
    found: Explanation, judged: Judgement, seen: Sensitivity, beyond: Explanation | None, rng: np.random.Generator
) -> Verdict:
    """The verdict on the best explanation, by what held-out sessions say of it.

    `beyond`: what is found when parameters may leave their ranges, where some would. Nothing that these explain as well
    is claimed. With a baseline a black box has no say: most of what it finds was there before.
    """
    nobody = tuple(False for _ in found.members)
    if not judged.heldout or seen.few or (beyond is not None and not beyond.anything):
        return Verdict("inconclusive", nobody, nobody, False, None, (), {}, False)
    heldout = dict(judged.heldout)
    box, refitted = heldout.pop("black_box"), heldout["refitted"]
    augmented = heldout.get("augmented", refitted)
    share = None if found.baseline else scores.explained_share(refitted, augmented, box, rng)
    beaten = () if found.baseline else tuple(scores.beats(list(heldout.values()), box))
    little = share is not None and share["ci95"][1] < EXPLAINED
    named = tuple(
        (beyond is None or m.hypothesis.effect.id in beyond.ids) and _stands(found, judged, i, little, rng)
        for i, m in enumerate(found.members)
    )
    moved = scores.difference(heldout["nominal"], refitted, rng)["ci95"][0] > 0
    pairs = [("nominal", "refitted"), *([("nominal", "augmented"), ("refitted", "augmented")] if found.members else [])]
    worse = {pair: scores.worse_at(heldout[pair[0]], heldout[pair[1]], rng) for pair in pairs}
    # A law with which forecasts explode is no physics, whatever it does to the next row: it stands for nothing.
    possible = tuple(not any(scores.explodes(a, b) for a, b in _pairs(judged, i)) for i in range(len(named)))
    verdict = _verdict(found, any(named), any(possible) or share is not None or bool(beaten), moved, seen)
    something_else = little or bool(beaten) or any(p and not n for p, n in zip(possible, named, strict=True))
    return Verdict(verdict, named, possible, something_else, share, beaten, worse, moved)


def _verdict(found: Explanation, named: bool, more: bool, moved: bool, seen: Sensitivity) -> str:
    """`named`: an effect is. `more`: there is one that is not, or a black box finds more."""
    if named:
        return "missing_physics"
    # What is periodic, or odd in single rows, can be predicted in part.
    accounted = any(s.id == "gait_oscillation" or s.rare for s in found.noise_effects)
    nameless = bool(found.whiteness.nats.any() or found.law.terms) and not accounted
    if more or nameless:
        return "unexplained"
    if found.noise_effects:
        return "missing_physics"
    if seen.undetectable_effects or seen.unexcited_channels:
        return "inconclusive"
    return "parameters_only" if moved else "nothing"


def _stands(found: Explanation, judged: Judgement, i: int, little: bool, rng: np.random.Generator) -> bool:
    """Whether a member is named: it explains most of what there is to explain, or stands out whatever else is missing.

    What makes forecasts worse is a wrong idea, however likely it makes the next row: surely worse, or on held-out
    and on fitted sessions alike.
    """
    m, pairs = found.members[i], _pairs(judged, i)
    dearer = set.intersection(*(scores.dearer_at(a, b) for a, b in pairs))
    if any(h > 1 for h in dearer) or any(h > 1 for a, b in pairs for h in scores.worse_at(a, b, rng)):
        return False
    return (found.names(m) and not little) or _stands_out(found, m, *pairs[0], rng)


def _pairs(judged: Judgement, i: int) -> tuple[tuple[Judged, Judged], tuple[Judged, Judged]]:
    """The model without a member and the one with it, on held-out and on fitted sessions."""
    heldout, fitted = judged.refitted_without[i]
    return (heldout, judged.heldout["augmented"]), (fitted, judged.fitted["augmented"])


def _stands_out(found: Explanation, m: Member, without: Judged, with_it: Judged, rng: np.random.Generator) -> bool:
    """Whether an effect improves held-out forecasts at every horizon, by much at one, with its constant well known."""
    if m.odds[m.hypothesis.effect.id] < LIKELY or m.misfit > m.gain or not scores.surely_likelier(without, with_it):
        return False
    if not differs_from_zero(found.problem, found.fit, m.hypothesis, found.sd, WELL_DETERMINED):
        return False
    outputs = np.flatnonzero(touched(found.problem.augmented.layout, found.fit, m.without)).tolist()
    removed = scores.changes(without, with_it, rng, outputs)
    return all(c["ci95"][1] < 0 for c in removed) and min(c["value"] for c in removed) < -LARGE
