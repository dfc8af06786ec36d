"""The model with the hidden state that is named, in place of the effects that stand in for it in the search."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.inference.explanation import Explanation, Hidden
from simgap.diagnosis.inference.fitting.model import without
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.diagnosis.likelihood.variables import Variables
from simgap.effects.augmented import Augmented
from simgap.engines import Behind, is_engine, split_as


class Deflected(NamedTuple):
    """An engine with a hidden state, and the model that was fitted with it: parameters, the state's constant, and the
    effects that it does not replace.

    Innovations, noise and the filter's gain are those of the search, where other effects stand in for the hidden state.
    No measurement corrects that state.
    """

    behind: Behind
    problem: Problem
    fit: Fit

    def chunks(self, chunks: Chunks) -> Chunks:
        """Segments with the hidden states too, which are zero; without tables, which are of the engine without them."""
        more = len(self.problem.augmented.layout.schema.state) - chunks.state.shape[-1]
        wide = [np.pad(np.asarray(a), ((0, 0), (0, 0), (0, more))) for a in (chunks.state, chunks.came)]
        return chunks._replace(state=wide[0], came=wide[1], table=None)


def deflected(found: Explanation) -> Deflected | None:
    """The model with the first hidden state that is named, where most is explained; None if none is.

    Others that are named were fitted without it, and each other.
    """
    hidden, simulator = next((h for h in found.hidden if h.named), None), found.problem.augmented.simulator
    if hidden is None or not is_engine(simulator):
        return None
    behind = Behind(hidden.term.where, hidden.term.effect, hidden.term.form)
    problem = found.problem._replace(augmented=Augmented(split_as(simulator, behind)))
    replaced = [g for m in found.members if m.hypothesis.name in hidden.replaces for g in m.hypothesis.groups]
    fit = without(found.fit, replaced)
    return Deflected(
        behind, problem, fit._replace(v=_variables(found.problem.augmented, problem.augmented, fit.v, hidden))
    )


def _variables(own: Augmented, split: Augmented, v: Variables, hidden: Hidden) -> Variables:
    """The variables of an engine for its rival, which has the same effects at the same sites and one more, the last."""
    assert split.slots[:-1] == own.slots
    value = 1 / hidden.value if hidden.term.reciprocal else hidden.value
    more, cross = len(split.layout.schema.state) - len(v.gain), dict(zip(own.layout.akin, v.cross, strict=True))
    return Variables(
        np.asarray(hidden.phi, np.float32),
        np.pad(v.gain, (0, more)),
        np.array([cross.get(pair, 0.0) for pair in split.layout.akin], np.float32),
        _wider(v.theta, value),
        _wider(v.delta, 0.0),
    )


def _wider(constants: Float[np.ndarray, "... P"], last: float) -> Float[np.ndarray, "... P+1"]:
    end = np.full((*np.shape(constants)[:-1], 1), last, np.float32)
    return np.concatenate([np.asarray(constants, np.float32), end], axis=-1)
