"""What changed since a baseline: what it shows by itself is no change, whether it moves the mean or the scatter."""

import numpy as np
from planted import SPOT, recordings, stalled
from small import RICH, ROWS, acting

from simgap.diagnosis import explain as explanation
from simgap.diagnosis.explain import Explanation

SAG = acting("gravity_sag", (0.06,))
BOTH = SAG | acting("delay", (1.4,), (0, 1, 2))
STALLS = 0.1


def since(before: dict, after: dict, share: float = 0.0) -> Explanation:
    """One session before, two after and one held out, with a share of their rows lost to the recorder."""
    old, new = recordings(before, RICH, 1, ROWS), recordings(after, RICH + 1, 3, ROWS)
    old = [stalled(r._replace(name="before"), share, 9) for r in old]
    new = [stalled(r, share, i) for i, r in enumerate(new)]
    return explanation.explain(SPOT.simulator, new[:2], new[2:], old, np.random.default_rng(0), print)


def test_what_came_since_is_named_and_what_was_there_before_is_not() -> None:
    found = since(SAG, BOTH)
    assert [m.candidate.effect.id for m in found.members] == ["delay"]
    assert found.names(found.members[0])


def test_where_nothing_changed_nothing_is_claimed() -> None:
    found = since(BOTH, BOTH)
    assert not found.members
    assert not found.scattered


def test_stalls_that_were_there_before_are_no_change() -> None:
    found = since({}, {}, STALLS)
    assert not found.members
    assert not found.scattered
