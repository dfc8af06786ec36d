"""When an effect gives way to a rival, and what does not make a restriction or a name."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from planted import SCALES, SPOT
from small import RICH, acting, problem, sessions

from simgap.diagnosis import diagnose as whole
from simgap.diagnosis import exchange
from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.fitting.model import Model, Trial
from simgap.diagnosis.inference.passes import explained
from simgap.diagnosis.inference.search.alternatives import _better
from simgap.diagnosis.inference.search.onsets import _restrictions
from simgap.diagnosis.likelihood.problem import evaluate, start
from simgap.types import Sessions

SATURATED, DELAYED = ("saturation", 50.0), ("sensor_delay", 40.0)


def trial(effect: str, evidence: float) -> Any:
    return SimpleNamespace(hypothesis=SimpleNamespace(effect=SimpleNamespace(id=effect)), evidence=evidence)


@pytest.mark.parametrize(
    ("rivals", "better"),
    [
        ([SATURATED], "saturation"),
        ([("saturation", 40.5)], None),  # no more than the fits' own tolerance
        ([("sensor_delay", 230.0), SATURATED], None),
        ([("sensor_delay", 45.0), SATURATED], "saturation"),
        ([("saturation", 300.0), ("sensor_delay", 230.0)], "saturation"),
    ],
)
def test_an_effect_gives_way_to_what_beats_it_wherever_it_acts(rivals: list, better: str | None) -> None:
    """Where the same effect at another site gains most, it is right, and may act at both."""
    holds: Any = lambda *_: True  # noqa: E731
    reduced: Any = SimpleNamespace(problem=None)
    found = _better(reduced, [trial(*r) for r in rivals], trial(*DELAYED), holds, 10.0)
    assert (found and found.hypothesis.effect.id) == better


@pytest.mark.parametrize("constants", [1, 2, 3])
def test_every_constant_of_an_effect_costs_as_much_as_it_gains_by_chance(constants: int) -> None:
    hypothesis: Any = SimpleNamespace(groups=(None,) * constants)
    fit: Any = SimpleNamespace(e=np.zeros((400, 2)), loglik=7.0)
    tried = Trial.of(hypothesis, fit, SimpleNamespace(loglik=-13.0))  # type: ignore[arg-type]
    assert tried.evidence == pytest.approx(20.0 - constants * np.log(400) / 2)


def test_a_rival_that_fits_better_throughout_is_no_onset() -> None:
    """Of a restriction only its own gain counts."""
    of = problem(sessions(acting("delay", (1.0,), (0,)), RICH)[0])
    hypothesis = next(h for h in hypotheses_of(SPOT, SCALES) if h.name == "delay on cmd_base_vx")
    model = Model(of, evaluate(of, vary(start(of), hypothesis, (1.0,)), hypothesis.groups), np.empty(0))
    level, ahead, behind = (
        [r.promise for r in _restrictions(model, hypothesis, model.fit.loglik + by)] for by in (0.0, -100.0, 100.0)
    )
    assert ahead == level
    assert behind == pytest.approx([promise - 100.0 for promise in level])


def test_velocities_of_all_bodies_may_be_equally_old() -> None:
    """One cause, such as the registers of motors of one kind, is one hypothesis."""
    delays = {h.where: h for h in hypotheses_of(SPOT, SCALES) if h.effect.id == "sensor_delay"}
    velocities = tuple(f.name for f in SPOT.simulator.schema.state if f.kind == "velocity")
    assert delays["sensors of velocity"].outputs == velocities
    assert len(delays["sensors of velocity"].groups) == 1
    assert {"base velocity", "sensors of pose", "sensors"} < delays.keys()


@pytest.mark.long
def test_what_only_the_last_search_found_is_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def last_of_three(*given: Any) -> Any:
        found, recorded = explained(*given)
        return found._replace(unsettled=frozenset({"delay"})), recorded

    monkeypatch.setattr(exchange, "explained", last_of_three)
    said = whole.diagnose(
        SPOT.simulator, "spot", Sessions(*sessions(acting("delay", (1.4,), (0, 1, 2)), RICH))
    ).statement
    assert said["verdict"] == "unexplained"
    assert [e["id"] for e in said["closest_matches"]] == ["delay"]
    assert any(note.startswith("delay was found by the last search alone") for note in said["notes"])
