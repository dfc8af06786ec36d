"""Rivals that act from a time on: a response that fades resembles one that drops at some time."""

from collections.abc import Sequence

import numpy as np

from simgap.diagnosis.config import REQUIRED
from simgap.diagnosis.hypotheses.support import ALWAYS, Support
from simgap.diagnosis.inference.evidence.null_distribution import blocks
from simgap.diagnosis.inference.fitting.model import Model
from simgap.diagnosis.inference.search.alternatives import Member, compared
from simgap.diagnosis.inference.search.onsets import as_throughout, from_on
from simgap.diagnosis.likelihood.problem import Fit
from simgap.diagnosis.likelihood.student_t import log_density


def among_late_rivals(model: Model, members: Sequence[Member], supports: Sequence[Support]) -> tuple[Member, ...]:
    """The members, with the odds of those that act throughout among rivals from a time on too. supports: the model's.

    A rival from a time on replaces what acts throughout only if it gains `REQUIRED` nats more. Until then either may be
    the cause.
    """
    return tuple(_compared(model, m, supports) if m.hypothesis.support == ALWAYS else m for m in members)


def _compared(model: Model, member: Member, supports: Sequence[Support]) -> Member:
    """The member; with other odds, if some rivals fit better from a time on."""
    problem, fit, _ = model
    named: dict[str, Fit] = {member.hypothesis.effect.id: fit}
    cost = {member.hypothesis.effect.id: 0.0}
    for t in member.rivals:
        throughout = as_throughout(model, t)
        late = from_on(throughout, t.hypothesis, fit.loglik, supports)
        named[t.hypothesis.effect.id] = (late or throughout).fit
        cost[t.hypothesis.effect.id] = REQUIRED if late else 0.0
    if not any(cost.values()):
        return member
    rows = {name: log_density(f.e, f.noise).sum(1) - cost[name] / len(f.e) for name, f in named.items()}
    constants = {h.effect.id: len(h.groups) for h in (member.hypothesis, *(t.hypothesis for t in member.rivals))}
    starts = blocks(np.asarray(problem.chunks.counts))
    return member._replace(odds=compared(rows, constants, starts, member.hypothesis.effect.id, member.gain))
