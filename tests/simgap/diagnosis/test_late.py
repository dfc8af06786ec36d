"""Rivals that act from a time on may have the name of an effect that acts throughout."""

from collections.abc import Sequence

import pytest
from planted import SCALES, SPOT
from small import RICH, acting, explain, problem, sessions

from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.hypotheses.support import From
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.fitting.model import Model, Trial
from simgap.diagnosis.inference.search.alternatives import Member, member
from simgap.diagnosis.inference.search.late import among_late_rivals
from simgap.diagnosis.inference.search.onsets import restriction
from simgap.diagnosis.likelihood.problem import evaluate, start, whitening
from simgap.types import Recording

pytestmark = pytest.mark.long

HYPOTHESES = {h.name: h for h in hypotheses_of(SPOT, SCALES)}
DRIFT, GAIN = "gain_drift on cmd_base_vx", "gain on cmd_base_vx"


def accepted(training: Sequence[Recording], names: Sequence[str]) -> tuple[Model, Member]:
    """A model with the first effect, and that effect next to the others as its rivals."""
    of = problem(list(training))
    of = of._replace(whiten=whitening(evaluate(of, start(of), ()).e))
    base, _ = optimise(of, evaluate(of, start(of), ()))
    fits = [optimise(of, evaluate(of, vary(base.v, h, h.starts[0]), h.groups)) for h in (HYPOTHESES[n] for n in names)]
    tried = [Trial.of(HYPOTHESES[n], fit, base) for n, (fit, _) in zip(names, fits, strict=True)]
    return Model(of, *fits[0]), member(of, tried, base)


@pytest.mark.parametrize("seed", [RICH, 7])
def test_a_response_that_drops_at_some_time_may_be_what_seems_to_fade(seed: int) -> None:
    training, heldout = sessions({}, seed, during=acting("gain", (-0.15,)), from_s=6.0)
    model, fades = accepted(training, [DRIFT, GAIN])
    assert fades.odds["gain_drift"] > 0.99  # as long as both act throughout
    (late,) = among_late_rivals(model, [fades], ())
    assert late.odds == pytest.approx({"gain_drift": 0.5, "gain": 0.5})
    found = restriction(model, (fades,), (), problem(heldout).chunks, print)
    assert isinstance(found, From)
    assert found.from_s == pytest.approx(6.0, abs=0.2)


@pytest.mark.parametrize("seed", [RICH, 7])
def test_a_response_that_fades_does_not_drop_at_some_time(seed: int) -> None:
    training, heldout = sessions(acting("gain_drift", (-0.9,)), seed)
    model, fades = accepted(training, [DRIFT, GAIN])
    (late,) = among_late_rivals(model, [fades], ())
    assert late.odds["gain_drift"] > 0.99
    assert restriction(model, (fades,), (), problem(heldout).chunks, print) is None


def test_a_time_costs_as_much_as_a_restriction_must_gain() -> None:
    """What acts throughout, and gains nothing by acting later, has the same odds as before."""
    training, _ = sessions(acting("delay", (1.0,), (0,)), RICH)
    model, late = accepted(training, ["delay on cmd_base_vx", "lag on cmd_base_vx"])
    assert among_late_rivals(model, [late], ())[0] is late


def test_what_shows_late_displaces_what_seems_to_act_throughout() -> None:
    """Over all rows the dead band is no rival of the drift that stands in for it: that explains half as much."""
    found = explain(*sessions({}, 7, during=acting("deadband", (0.06,), (3,)), from_s=7.0))
    (member,) = found.members
    assert member.hypothesis.name == "deadband on cmd_ee_vx"
    assert isinstance(member.hypothesis.support, From)
    assert member.hypothesis.support.from_s == pytest.approx(7.0, abs=0.2)
