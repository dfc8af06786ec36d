"""What speaks for and against an effect that was found, in a few numbers without unit."""

from typing import NamedTuple

import numpy as np

from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.misfit.whiteness import touched
from simgap.diagnosis.validation import scores
from simgap.diagnosis.validation.mistaken import mistaken
from simgap.diagnosis.validation.scores import Judged, Judgement

TINY = 1e-3
"""Ratios below this say no more than it: the errors of simulated machines can vanish."""


class Indicators(NamedTuple):
    """What speaks for and against an effect.

    gain: ln of its gain [nats]. lesser: ln of the largest gain of an effect found over its own: what comes after a
    strong effect may only mend the form of its law. misfit: ln of one plus what only a bent law would gain [nats].
    bending: the share of that in the gain of the bent law. heldout: gain in a held-out row over that in a fitted one.
    next_row, far: ln of the error with the effect over the one without, on held-out sessions and in the outputs it
    improves, after one row and after the most rows. nameless: share of what there is to explain in these outputs that
    is left, as predictable residuals or a law without a name. rivals: ln of the number of names compared, its own among
    them: these come near. mistaken: how often such an effect is found where it is not the cause (see `mistaken`).
    """

    gain: float
    lesser: float
    misfit: float
    bending: float
    heldout: float
    next_row: float
    far: float
    nameless: float
    rivals: float
    mistaken: float


def indicators(found: Explanation, judged: Judgement, i: int, heldout_gain: float) -> Indicators:
    """Of the i-th effect found, which gains `heldout_gain` nats on held-out sessions."""
    m = found.members[i]
    held, fitted = (max(int(np.asarray(c.counts).sum()), 1) for c in (found.unseen, found.problem.chunks))
    most = max(other.gain for other in found.members)
    outputs = np.flatnonzero(touched(found.problem.augmented.layout, found.fit, m.without)).tolist()
    pair = judged.refitted_without[i][0], judged.heldout["augmented"]
    return Indicators(
        gain=_log(m.gain, 1.0),
        lesser=_log(most, m.gain),
        misfit=float(np.log1p(m.misfit)),
        bending=m.misfit / max(m.gain + m.misfit, TINY),
        heldout=heldout_gain / held / (max(m.gain, TINY) / fitted),
        next_row=_error(pair, 0, outputs),
        far=_error(pair, -1, outputs),
        nameless=1.0 - found.named_share(m),
        rivals=float(np.log(len(m.odds))),
        mistaken=mistaken(m.hypothesis.effect.id),
    )


def _error(pair: tuple[Judged, Judged], k: int, outputs: list[int]) -> float:
    before, after = (scores.relative_error(j, k, outputs=outputs)[0] for j in pair)
    return _log(after, before)


def _log(a: float, b: float) -> float:
    """ln(a / b), with neither negligible."""
    if not (np.isfinite(a) and np.isfinite(b)):
        return 0.0 if np.isfinite(a) == np.isfinite(b) else float(np.copysign(-np.log(TINY), np.isfinite(b) - 0.5))
    return float(np.log(max(a, TINY) / max(b, TINY)))
