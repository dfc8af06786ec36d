"""What changed since a baseline: what it shows by itself is no change, whether it moves the mean or the scatter."""

import numpy as np
import pytest
from planted import SPOT, recordings, stalled
from small import RICH, ROWS, acting, assert_explains, problem

from simgap.diagnosis.config import LEAST_SESSIONS
from simgap.diagnosis.hypotheses.space import changed, hypotheses_of
from simgap.diagnosis.hypotheses.support import Since, Window, opened
from simgap.diagnosis.inference import explain as explanation
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.fitting.model import Trial
from simgap.diagnosis.inference.search.posterior import constants
from simgap.diagnosis.inference.two_sample import differs
from simgap.diagnosis.likelihood.problem import evaluate, start, whitening
from simgap.types import Recording, Sessions

pytestmark = pytest.mark.long

SAG = acting("gravity_sag", (0.06,))
BOTH = SAG | acting("delay", (1.4,), (0, 1, 2))
STALLS = 0.1


def since(before: dict, after: dict, share: float = 0.0) -> Explanation:
    """One session before, two after and one held out, with a share of their rows lost to the recorder."""
    old, new = recordings(before, RICH, 1, ROWS), recordings(after, RICH + 1, 3, ROWS)
    old = [stalled(r._replace(name="before"), share, 9) for r in old]
    new = [stalled(r, share, i) for i, r in enumerate(new)]
    return explanation.explain(SPOT.simulator, Sessions(new[:2], new[2:], old), np.random.default_rng(0), print)


def test_what_came_since_is_named_and_what_was_there_before_is_not() -> None:
    found = since(SAG, BOTH)
    assert [m.hypothesis.effect.id for m in found.members] == ["delay"]
    assert_explains(found, found.members[0])


def test_of_a_change_the_change_is_told() -> None:
    found = since(acting("delay", (0.6,), (0, 1, 2)), BOTH | acting("gravity_sag", (0.0,)))
    (member,) = found.members
    (estimate,) = constants(found.problem, found.fit, member.hypothesis, found.sd, member.gain)
    assert estimate["unit"] == "s"
    assert estimate["value"] == pytest.approx(0.8 / 15, rel=0.1)
    assert estimate["ci95"][0] < 0.8 / 15 < estimate["ci95"][1]


def test_a_push_since_is_told_as_such() -> None:
    """Though a drift in all sessions since would explain it in part."""
    push = acting("external_push.own_frame", (0.4,), (1,))
    old, held = recordings({}, RICH, 1, ROWS), recordings({}, RICH + 2, 1, ROWS)
    new = recordings({}, RICH + 1, 2, ROWS, during=push, from_s=5.0, to_s=7.0, only=1)
    old, held = ([r._replace(name=name) for r in some] for name, some in (("before", old), ("held out", held)))
    found = explanation.explain(SPOT.simulator, Sessions(new, held, old), np.random.default_rng(0), print)
    (member,) = found.members
    assert member.hypothesis.effect.id == "external_push"
    assert isinstance(member.hypothesis.support, Window)
    assert member.hypothesis.support.from_s == pytest.approx(5.0, abs=0.3)
    assert member.hypothesis.support.to_s == pytest.approx(7.0, abs=0.3)


def test_where_nothing_changed_nothing_is_claimed() -> None:
    found = since(BOTH, BOTH)
    assert not found.members
    assert not found.noise_effects


def test_stalls_that_were_there_before_are_no_change() -> None:
    found = since({}, {}, STALLS)
    assert not found.members
    assert not found.noise_effects


def followed(gains: tuple[float, ...], seed: int) -> list[Recording]:
    """A session for each factor by which the base follows its commands."""
    each = [recordings(acting("gain", (g - 1,), (0, 1, 2)), seed + i, 1, ROWS)[0] for i, g in enumerate(gains)]
    return [r._replace(name=f"{seed}-{i}") for i, r in enumerate(each)]


@pytest.mark.parametrize(
    ("before", "after", "change"),
    [
        ((0.6, 0.9, 0.7, 1.05, 0.8), (0.9, 0.7, 1.05, 0.8, 0.5), False),
        ((0.75, 0.9, 0.8, 0.95, 0.85), (0.25, 0.4, 0.3, 0.45, 0.35), True),
    ],
)
def test_what_varies_from_session_to_session_is_no_change(
    before: tuple[float, ...], after: tuple[float, ...], change: bool
) -> None:
    """The likelihood alone would have it otherwise: no two sets of such sessions are alike."""
    assert len(before) == LEAST_SESSIONS
    sessions = [*followed(before, RICH), *followed(after, RICH + 50)]
    of = problem(sessions)
    of = of._replace(chunks=opened(SPOT.layout, of.chunks, [Since(len(before))]))
    of = of._replace(whiten=whitening(evaluate(of, start(of), ()).e))
    gain = changed(next(h for h in hypotheses_of(SPOT, of.scales) if h.name == "gain on base"), len(before))
    base, _ = optimise(of, evaluate(of, start(of), gain.twin))
    begun = vary(base.v, gain, (-0.05,))
    fitted, _ = optimise(of, evaluate(of, begun, (*gain.twin, *gain.groups)))
    tried = Trial.of(gain, fitted, base)
    assert tried.gain > 10
    assert differs(of, tried, len(before)) == change
