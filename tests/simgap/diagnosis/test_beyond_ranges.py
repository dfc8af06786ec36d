"""An effect is claimed only if it is needed even when parameters may leave their ranges."""

import numpy as np
import pytest
from test_numerics import known
from test_ranges import driven, ranged

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.explain import explain
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.search import posterior
from simgap.diagnosis.inference.search.alternatives import Member
from simgap.diagnosis.likelihood.problem import evaluate
from simgap.diagnosis.validation.ranges import needed_beyond_ranges
from simgap.types import Sessions

pytestmark = pytest.mark.long

NARROW = ranged((1.0, 5.0), (0.1, 2.0))
"""The damping is 5 N s/m."""


def with_effect(name: str, friction: float) -> Explanation:
    """An explanation by one effect alone, as if a search had accepted it."""
    recordings = driven((2.5, 5.0), friction=friction)
    found = explain(NARROW, Sessions(recordings[:3], recordings[3:]), np.random.default_rng(0), print)
    assert posterior.at_bound(found.problem, found.base)
    effect, base = known(found.problem, name), found.base
    begun = evaluate(found.problem, vary(base.v, effect, effect.starts[0]), effect.groups)
    fit, _ = optimise(found.problem, begun)
    member = Member(effect, fit.loglik - base.loglik, {effect.effect.id: 1.0}, (), base)
    return found._replace(fit=fit, members=(member,))


@pytest.mark.parametrize(
    ("name", "friction", "needed"),
    [("viscous_drag on velocity", 0.0, False), ("coulomb_friction on velocity", 3.0, True)],
    ids=["a greater damping is the same", "no damping is dry friction"],
)
def test_an_effect_is_needed_if_no_parameter_takes_its_place(name: str, friction: float, needed: bool) -> None:
    found = with_effect(name, friction)
    assert found.members[0].gain > 10
    assert needed_beyond_ranges(found) == needed


def test_an_effect_that_is_needed_is_named_without_another_search() -> None:
    recordings, lines = driven((2.5, 5.0), friction=3.0), []
    statement = diagnose(NARROW, "drive", Sessions(recordings[:3], recordings[3:]), report=lines.append).statement
    assert statement["parameters"]["at_bound"] == ["damping"]
    assert not any("without parameter ranges" in line for line in lines)
    assert statement["verdict"] == "missing_physics"
    assert [effect["id"] for effect in statement["effects"]] == ["coulomb_friction"]
