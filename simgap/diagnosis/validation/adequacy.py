"""The verdict: which effects are named, whether something else is missing, and whether the recordings suffice."""

from typing import Any, NamedTuple

import numpy as np

from simgap.diagnosis.config import EXPLAINED, KNOWN, LIKELY
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.fitting.heldout import gain
from simgap.diagnosis.inference.noise.effect import NoiseEffect, Spectrum
from simgap.diagnosis.inference.search.alternatives import Member
from simgap.diagnosis.inference.search.posterior import deviations_for, differs_from_zero
from simgap.diagnosis.likelihood.problem import evaluate
from simgap.diagnosis.validation import scores
from simgap.diagnosis.validation.calibration import probability
from simgap.diagnosis.validation.indicators import Indicators, indicators
from simgap.diagnosis.validation.scores import Judged, Judgement
from simgap.diagnosis.validation.sensitivity import Sensitivity


class Verdict(NamedTuple):
    """The conclusion of a diagnosis.

    verdict: as in diagnosis.json. named, possible: for each member, whether it is named, and whether it could be.
    something_else: whether more is missing than the named effects. share: of the black box's one-step gain that the
    members reach. beaten_at: horizons [rows] at which a black box is significantly better than all other models on
    held-out sessions. worse_at: horizons at which the second model of a pair is worse than the first. parameters_moved:
    whether refitting the parameters alone improves the held-out sessions. heldout_gains: of each member [nats], with
    all constants as fitted; indicators: what speaks for and against it; known: probability that the cause is among its
    names (see `calibration`). These three are empty if there are no scores.
    """

    verdict: str
    named: tuple[bool, ...]
    possible: tuple[bool, ...]
    something_else: bool
    share: dict[str, Any] | None
    beaten_at: tuple[int, ...]
    worse_at: dict[tuple[str, str], list[int]]
    parameters_moved: bool
    heldout_gains: tuple[float, ...] = ()
    indicators: tuple[Indicators, ...] = ()
    known: tuple[float, ...] = ()

    @property
    def noise_named(self) -> bool:
        """Whether effects on the noise are named: not while physics is missing that may scatter the rows instead."""
        return self.verdict == "missing_physics" and not self.something_else

    def noise_known(self, effect: NoiseEffect) -> float:
        """Probability that an effect on the noise is no other physics: if a name is wrong, what it stands in for may
        scatter the rows. It hardly makes a line in a spectrum."""
        sure = (p for p, named in zip(self.known, self.named, strict=False) if named)
        return 1.0 if isinstance(effect.shown, Spectrum) else min(sure, default=1.0)


def conclude(
    found: Explanation, judged: Judgement, seen: Sensitivity, beyond: Explanation | None, rng: np.random.Generator
) -> Verdict:
    """The verdict on the best explanation, from its scores on held-out sessions.

    `beyond`: the explanation found when parameters may leave their ranges, if some would. An effect that it lacks is
    not named. With a baseline the black box is ignored: most of what it finds was there before.
    """
    all_false = tuple(False for _ in found.members)
    if not judged.heldout or seen.few or (beyond is not None and not beyond.anything):
        return Verdict("inconclusive", all_false, all_false, False, None, (), {}, False)
    heldout = dict(judged.heldout)
    box, refitted = heldout.pop("black_box"), heldout["refitted"]
    augmented = heldout.get("augmented", refitted)
    share = None if found.baseline else scores.explained_share(refitted, augmented, box, rng)
    beaten = () if found.baseline else tuple(scores.beats(list(heldout.values()), box))
    low_share = share is not None and share["ci95"][1] < EXPLAINED
    without = (evaluate(found.problem, m.without.v, ()) for m in found.members)
    gains = tuple(gain(found.problem, found.unseen, fit, found.fit) for fit in without)
    marks = tuple(indicators(found, judged, i, nats) for i, nats in enumerate(gains))
    known = tuple(map(probability, marks))
    named = tuple(
        (beyond is None or m.hypothesis.effect.id in beyond.ids)
        and is_likely(m, known[i])
        and _is_named(found, judged, i, rng)
        for i, m in enumerate(found.members)
    )
    moved = scores.difference(heldout["nominal"], refitted, rng)["ci95"][0] > 0
    pairs = [("nominal", "refitted"), *([("nominal", "augmented"), ("refitted", "augmented")] if found.members else [])]
    worse = {pair: scores.worse_at(heldout[pair[0]], heldout[pair[1]], rng) for pair in pairs}
    # A law with which forecasts diverge cannot be physical, however well it predicts the next row.
    possible = tuple(
        not found.stands_in(m) and not any(scores.explodes(a, b) for a, b in _pairs(judged, i))
        for i, m in enumerate(found.members)
    )
    # A refit that forecasts worse than the simulator before it was led astray by what the simulator lacks.
    misled = bool(worse["nominal", "refitted"]) and bool(found.noise_effects)
    more = any(possible) or share is not None or bool(beaten) or misled
    hidden = any(h.named for h in found.hidden)
    verdict = _verdict(found, any(named) or hidden, more, moved, seen)
    # Forecasts have what stands in for a hidden state, so what these lack may be the hidden state.
    something_else = (not hidden and (low_share or bool(beaten))) or any(
        p and not n for p, n in zip(possible, named, strict=True)
    )
    return Verdict(verdict, named, possible, something_else, share, beaten, worse, moved, gains, marks, known)


def _verdict(found: Explanation, named: bool, more: bool, moved: bool, seen: Sensitivity) -> str:
    """`named`: whether an effect is named. `more`: whether one is possible, or the black box gains significantly."""
    if named:
        return "missing_physics"
    explained = any(effect.predictable for effect in found.noise_effects)
    unnamed = bool(found.whiteness.nats.any() or found.law.terms) and not explained
    if more or unnamed:
        return "unexplained"
    if found.noise_effects:
        return "missing_physics"
    if seen.undetectable_effects or seen.unexcited_channels or found.elsewhere:
        return "inconclusive"
    return "parameters_only" if moved else "nothing"


def is_likely(member: Member, known: float) -> bool:
    """Whether an effect is likely enough for its name. known: probability that the cause is among its names."""
    return known >= KNOWN and known * member.odds[member.hypothesis.effect.id] >= LIKELY


def _is_named(found: Explanation, judged: Judgement, i: int, rng: np.random.Generator) -> bool:
    """Whether a likely cause may have its name: the search before found it too, if there were several, its constants
    are plausible and not all intervals of its amplitudes include zero, and forecasts of several steps do not become
    worse by it, however well it predicts the next row: significantly on held-out or fitted sessions, or by
    `LEAST_SHARE` on both."""
    m, pairs = found.members[i], _pairs(judged, i)
    if m.hypothesis.effect.id in found.unsettled or found.stands_in(m):
        return False
    worse_on_both = set.intersection(*(scores.dearer_at(a, b) for a, b in pairs))
    if any(h > 1 for h in worse_on_both) or any(h > 1 for a, b in pairs for h in scores.worse_at(a, b, rng)):
        return False
    return differs_from_zero(found.problem, found.fit, m.hypothesis, found.sd, deviations_for(m.gain))


def _pairs(judged: Judgement, i: int) -> tuple[tuple[Judged, Judged], tuple[Judged, Judged]]:
    """Scores of the model without a member and of the one with it, on held-out and on fitted sessions."""
    heldout, fitted = judged.refitted_without[i]
    return (heldout, judged.heldout["augmented"]), (fitted, judged.fitted["augmented"])
