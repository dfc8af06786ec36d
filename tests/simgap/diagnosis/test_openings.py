"""Which effect comes first in a search does not decide how it ends."""

from typing import Any

import numpy as np
import pytest

from simgap.diagnosis.inference import explain
from simgap.diagnosis.inference.fitting.model import Found, Round
from simgap.diagnosis.inference.search import select
from simgap.ground.draw import recorded
from simgap.ground.machines import CART

WRONG, RIGHT = "load_friction", {"saturation", "coulomb_friction"}


@pytest.fixture(name="found")
def _found(monkeypatch: pytest.MonkeyPatch) -> list[Found]:
    """Results of searches in whose first round a wrong effect seems to gain a little more than the best."""
    found, one_more, search = [], select.one_more, select.search

    def misled(*given: Any) -> Round:
        current, chosen = one_more(*given), given[4]
        if chosen:
            return current
        wrong = next(t for t in current.tried if t.hypothesis.effect.id == WRONG)
        others = [t for t in current.tried if t is not wrong]
        return current._replace(tried=[wrong._replace(gain=others[0].gain + 1.0), *others])

    def kept(*given: Any) -> Found:
        found.append(search(*given))
        return found[-1]

    monkeypatch.setattr(select, "one_more", misled)
    monkeypatch.setattr(explain, "search", kept)
    return found


@pytest.mark.long
def test_a_search_that_begins_with_a_wrong_effect_ends_with_the_right_ones(found: list[Found]) -> None:
    case = recorded(1, CART, "two", ("friction", "saturation"))
    lines: list[str] = []
    explain.explain(case.machine, case.sessions, np.random.default_rng(0), lines.append)
    added = [line.split()[1] for line in lines if line.startswith("added")]
    assert added[0] == WRONG
    assert {h.effect.id for h in found[0].chosen} == RIGHT
