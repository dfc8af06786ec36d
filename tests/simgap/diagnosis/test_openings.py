"""Which effect comes first in a search does not decide how it ends."""

from typing import Any

import numpy as np
import pytest

from simgap.diagnosis.inference import select
from simgap.diagnosis.inference.explain import explain
from simgap.diagnosis.inference.model import Round
from simgap.ground.draw import recorded
from simgap.ground.machines import PAIR

PLANTED = {"delay", "rate_limit"}


@pytest.fixture(name="begun")
def misled(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """First rounds in which a wrong effect seems to gain a little more than the best; and the ids taken first."""
    taken, one_more = [], select.one_more

    def first_wrong(model: Any, hypotheses: Any, rng: Any, report: Any, found: Any) -> Round:
        current = one_more(model, hypotheses, rng, report, found)
        if found:
            return current
        best = current.tried[0]
        wrong = next(t for t in current.tried if t.hypothesis.effect.id == "backlash")
        taken.append(wrong.hypothesis.effect.id)
        seeming = wrong._replace(gain=best.gain + 1.0)
        return current._replace(tried=[seeming, *(t for t in current.tried if t is not wrong)])

    monkeypatch.setattr(select, "one_more", first_wrong)
    return taken


def test_a_search_that_begins_with_a_wrong_effect_ends_with_the_right_ones(begun: list[str]) -> None:
    case = recorded(1, PAIR, "within", ("delay", "rate_limit"))
    lines: list[str] = []
    found = explain(case.machine, case.sessions, np.random.default_rng(0), lines.append)
    print(*lines, sep="\n")
    assert begun == ["backlash"]
    assert any(line.startswith("a search that begins with rate_limit") for line in lines)
    assert {m.hypothesis.effect.id for m in found.members} == PLANTED
