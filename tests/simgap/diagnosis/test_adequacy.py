"""Verdicts: what too little data leaves open, what "nothing" claims, and names that stand whatever else is missing."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from outside import SPOT as AS_IT_IS
from planted import PHI, SENSOR, SPOT
from scipy.stats import binom
from small import RICH, acting, sessions

from simgap.diagnosis.config import LEAST_SHARE, LEVEL
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.report import forecasts, wording
from simgap.diagnosis.report.answers import change_of
from simgap.diagnosis.validation import adequacy
from simgap.diagnosis.validation.adequacy import conclude
from simgap.diagnosis.validation.scores import (
    HORIZONS,
    Judged,
    Judgement,
    beats,
    changes,
    dearer_at,
    surely_likelier,
    worse_at,
)
from simgap.types import Recording, Sessions

pytestmark = pytest.mark.long


def judged(error: np.ndarray, moved: float = 1.0, sessions: int = 2, nll: float = 0.0) -> Judged:
    """Pieces [n, horizons, outputs] of sessions one after the other."""
    n = len(error)
    return Judged(error, np.full_like(error, moved), np.full(n, nll), np.arange(n) * sessions // n)


def noise(seed: int, scale: float = 1.0, n: int = 200) -> np.ndarray:
    return scale * np.random.default_rng(seed).normal(size=(n, len(HORIZONS), 3))


# A black box against the simulator


@pytest.mark.parametrize("k", range(len(HORIZONS)))
def test_a_black_box_that_is_clearly_better_at_one_horizon_is_noticed_there(k: int) -> None:
    simulator, box = noise(0), noise(1)
    box[:, k] *= 0.3
    assert beats([judged(simulator)], judged(box)) == [HORIZONS[k]]


def test_it_must_beat_the_better_of_the_simulators() -> None:
    nominal, refitted, box = judged(noise(0, 0.2)), judged(noise(1, 1.0)), judged(noise(2, 0.6))
    assert beats([refitted], box) == list(HORIZONS)
    assert beats([nominal, refitted], box) == []


@pytest.mark.parametrize("units", [2, 5, 20])
def test_alike_by_chance_is_seldom_better(units: int) -> None:
    """Two models of equal error pass for unequal with the chance `LEVEL`, for all horizons together."""
    draws = (np.random.default_rng(seed).normal(size=(2, 200, len(HORIZONS), 3)) for seed in range(2000))
    passed = sum(bool(beats([judged(a, sessions=units)], judged(b, sessions=units))) for a, b in draws)
    assert passed <= binom.ppf(0.999, 2000, LEVEL)


def test_forecasts_that_explode_are_compared_without_a_word() -> None:
    exploded = judged(np.full((50, 3, 2), np.inf, np.float32))
    assert beats([exploded], judged(noise(0, n=50)[..., :2])) == []
    assert beats([judged(noise(0, n=50)[..., :2])], exploded) == []


def test_the_change_by_effects_is_from_the_better_of_the_models_without_them() -> None:
    nominal, refitted, augmented = judged(noise(0, 0.8)), judged(noise(1)), judged(noise(2, 0.4))
    found = change_of({"nominal": nominal, "refitted": refitted, "augmented": augmented}, np.random.default_rng(0))
    assert found is not None
    assert (found["than"], found["at"]) == ("nominal", HORIZONS[-1])
    assert found["value"] == pytest.approx(-0.5, abs=0.1)
    assert found["ci95"][0] < found["value"] < found["ci95"][1] < 0
    assert change_of({"nominal": nominal, "refitted": refitted}, np.random.default_rng(0)) is None


def test_where_refitting_makes_it_worse_is_known_by_horizon() -> None:
    nominal, refitted = noise(0), noise(0)
    refitted[:, 2] *= 1.5
    rng = np.random.default_rng(0)
    assert worse_at(judged(nominal), judged(refitted), rng) == [HORIZONS[2]]
    (_, _, last) = changes(judged(nominal), judged(refitted), rng)
    assert last["value"] == pytest.approx(0.5)
    assert changes(judged(nominal), judged(refitted), rng, [0])[2]["value"] == pytest.approx(0.5)


def test_where_a_model_costs_more_than_laws_may_differ_is_known_by_horizon() -> None:
    before, after = noise(0), noise(0)
    after[:, 1] *= 1.02
    after[:, 2] *= 1.05
    assert dearer_at(judged(before), judged(after)) == {HORIZONS[2]}
    assert dearer_at(judged(after), judged(before)) == set()
    after[:, 0] = np.inf
    assert dearer_at(judged(before), judged(after)) == {HORIZONS[0], HORIZONS[2]}


@pytest.mark.parametrize(("refit", "verdict"), [(1.0, "missing_physics"), (1.5, "unexplained")])
def test_noise_about_a_refit_that_forecasts_worse_is_no_finding(refit: float, verdict: str) -> None:
    """Then the refit was led astray, and its noise stands for what its laws lack."""
    refitted = noise(0)
    refitted[:, 2] *= refit
    heldout = {"nominal": judged(noise(0)), "refitted": judged(refitted), "black_box": judged(refitted)}
    nothing: Any = SimpleNamespace(nats=np.zeros(1), terms=())
    found: Any = SimpleNamespace(members=(), noise_effects=[SimpleNamespace(predictable=False)], baseline=0,
                                 hidden=(), whiteness=nothing, law=nothing, elsewhere=None)  # fmt: skip
    seen: Any = SimpleNamespace(few=False, undetectable_effects=(), unexcited_channels=())
    rng = np.random.default_rng(0)
    assert conclude(found, Judgement(heldout, heldout, ()), seen, None, rng).verdict == verdict


@pytest.mark.parametrize(("far", "unsettled", "named"), [(0.9, False, True), (1.1, False, False), (0.9, True, False)])
def test_what_makes_forecasts_worse_or_was_not_found_before_has_no_name(
    far: float, unsettled: bool, named: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []
    monkeypatch.setattr(adequacy, "differs_from_zero", lambda *given: asked.append(given[-1]) is None)
    error = noise(0)
    error[:, 2] *= far
    without, augmented = judged(noise(0)), judged(error)
    member: Any = SimpleNamespace(hypothesis=SimpleNamespace(effect=SimpleNamespace(id="sensor_scale")), gain=400.0)
    ids = frozenset({"sensor_scale"} if unsettled else ())
    found: Any = SimpleNamespace(
        members=[member], unsettled=ids, stands_in=lambda _: False, problem=None, fit=None, sd=None
    )
    of = Judgement({"augmented": augmented}, {"augmented": augmented}, ((without, without),))
    assert adequacy._is_named(found, of, 0, np.random.default_rng(0)) == named
    # The interval that is stated must exclude zero. It covers what a small share of the gain would cost, too.
    assert asked == ([pytest.approx(np.sqrt(1.96**2 + 2 * LEAST_SHARE * 400), rel=1e-3)] if named else [])


def test_two_pieces_are_too_few_to_be_sure() -> None:
    assert not surely_likelier(judged(noise(0, n=2), nll=5.0, sessions=1), judged(noise(0, n=2), nll=0.0, sessions=1))


# Too little data


def still(r: Recording) -> Recording:
    """As long, of a robot that stands and is commanded to: its sensors' noise alone."""
    positions = [0.0 if f.kind == "velocity" else 1.0 for f in AS_IT_IS.schema.state]
    seen = np.random.default_rng(int(r.name[1:])).normal(size=r.state.shape) * SENSOR
    return Recording(r.name, r.time_s, r.state[:1] * positions + seen, 0 * r.command)


@cache
def stated(kind: str) -> dict[str, Any]:
    training, heldout = sessions({}, RICH)
    if kind == "short":
        training, heldout = ([Recording(r.name, r.time_s[:5], r.state[:5], r.command[:5]) for r in some]
                             for some in (training, heldout))  # fmt: skip
    if kind == "still":
        training, heldout = ([still(r) for r in some] for some in (training, heldout))
    return diagnose(AS_IT_IS, "spot", Sessions(training, heldout)).statement


def test_sessions_of_five_rows_are_too_little() -> None:
    said = stated("short")
    assert said["verdict"] == "inconclusive"
    assert said["effects"] == said["closest_matches"] == []
    assert said["sensitivity"]["segments"] == 3
    assert "3 independent segments" in said["statement"]
    assert "Record at least" in said["statement"]


def test_where_nothing_moves_nothing_can_be_said() -> None:
    said = stated("still")
    assert said["verdict"] == "inconclusive"
    assert {"delay", "lag", "saturation"} <= set(said["sensitivity"]["undetectable_effects"])
    assert set(said["sensitivity"]["unexcited_channels"]) == {f.name for f in AS_IT_IS.schema.command}
    assert "cmd_base_vx" in said["statement"]


def test_nothing_says_what_it_would_have_found_and_at_what_size() -> None:
    said = stated("rich")
    assert said["verdict"] == "nothing"
    sizes = {(v["effect"], v["where"]): v["size"] for v in said["sensitivity"]["effects"]}
    assert 0 < sizes["delay", "cmd_base_vx"] <= 0.5 / 15
    assert 0 < sizes["coulomb_friction", "base_vx"] < 0.1
    assert sizes["sensor_bias", "ee_z"] is None  # a height has no origin in this simulator
    assert "delay on cmd_base_vx" in said["statement"]
    assert said["insufficient"] == []


def test_an_effect_of_the_size_that_is_stated_is_found() -> None:
    """Three times the smallest size is a gain of nine times what is needed."""
    (size,) = (v["size"] for v in stated("rich")["sensitivity"]["effects"]
               if (v["effect"], v["where"]) == ("coulomb_friction", "base_vx"))  # fmt: skip
    said = diagnose(
        AS_IT_IS, "spot", Sessions(*sessions(acting("coulomb_friction", (3 * size,), (0,)), RICH))
    ).statement
    assert said["verdict"] == "missing_physics"


# One effect, and something else


@cache
def delay_and_more() -> dict[str, Any]:
    """A delay of the base's commands, and a hand that is lifted by speed times turning, of which there is no word."""
    training, heldout = sessions(acting("delay", (1.4,), (0, 1, 2)), RICH)

    def lifted(r: Recording) -> Recording:
        forward = np.cos(r.state[:, 2]) * r.state[:, 3] + np.sin(r.state[:, 2]) * r.state[:, 4]
        push, state = 2.0 * forward * r.state[:, 5], r.state.copy()
        state[:, 11] += push
        state[:, 8] += np.cumsum(push) / 15
        return r._replace(state=state)

    return diagnose(AS_IT_IS, "spot", Sessions(*([lifted(r) for r in some] for some in (training, heldout)))).statement


def test_a_strong_effect_is_named_though_more_is_missing() -> None:
    said = delay_and_more()
    assert said["verdict"] == "missing_physics"
    assert "delay" in [e["id"] for e in said["effects"]]
    assert said["more_missing"] or said["nonparametric"] or said["whiteness"]["outputs"]
    assert "Something else is missing as well" in said["statement"]


# Words


def models(**errors: float) -> dict[str, Any]:
    return {m: {"nll_1": {"value": -1.0}, "error_1": {"value": e}, "error_50": {"value": e}} for m, e in errors.items()}


def test_the_headline_compares_with_the_better_of_nominal_and_refitted() -> None:
    change = {"than": "nominal", "at": 50, "value": -0.9, "ci95": [-0.92, -0.88]}
    fit = {"models": models(nominal=0.175, refitted=0.376, augmented=0.017), "change": change}
    assert "from 17.5% (the simulator as it is) to 1.7%" in forecasts.improvement({"fit": fit, "effects": []})
    started = forecasts.improvement({"fit": fit, "effects": [], "model_file": {"start": {"kp pan": 0.05}}})
    assert "from 17.5% (the simulator as the search began) to 1.7%" in started
    assert "may be chance" not in started
    for ends in ([-0.99, 0.1], [-0.9, -0.9]):  # the second one is of a single piece of a session
        unclear = {**fit, "change": {**change, "ci95": ends}}
        assert "to 1.7% of the motion, which may be chance;" in forecasts.improvement({"fit": unclear, "effects": []})


def test_a_refit_that_is_worse_is_a_warning() -> None:
    worse = [{"model": "refitted", "than": "nominal", "at": [50]}]
    (line,) = forecasts.warnings({"fit": {"models": models(nominal=0.175, refitted=0.376), "worse": worse}})
    assert "the refitted simulator is worse than the simulator as it is after 50 steps: 37.6% against 17.5%" in line


@pytest.mark.parametrize(
    ("credible", "said"), [(["lag"], "A lag."), (["lag", "delay"], "A lag. The recordings cannot")]
)
def test_a_tie_is_said_where_its_effect_is_named(credible: list[str], said: str) -> None:
    effect = {"id": "lag", "probability": 0.5, "credible_set": credible, "statement": "A lag."}
    sentence = wording._named(effect)
    assert sentence.startswith(said)
    assert ("cannot tell this from delay: that it is lag has a probability of 50%" in sentence) == (len(credible) > 1)


@pytest.mark.parametrize(
    ("outside", "said"),
    [((0.0, 0.02), "The simulator leaves out: A lag. A slope."),
     ((0.3, 0.0), "The simulator leaves out: A slope. It probably also leaves out: A lag. With a probability of 30%"),
     ((0.3, 0.4), "The simulator probably leaves out: A lag. With a probability of 30%")],
)  # fmt: skip
def test_what_is_likely_is_not_said_to_be_certain(outside: tuple[float, float], said: str) -> None:
    effects = [{"id": i, "probability": 1 - p, "outside": p, "credible_set": [i], "statement": f"A {i}.",
                "support": {"regime": None}} for i, p in zip(("lag", "slope"), outside, strict=True)]  # fmt: skip
    diagnosis = {"effects": effects, "whiteness": {"outputs": []}, "nonparametric": [], "more_missing": False,
                 "located": {"regimes": []}}  # fmt: skip
    assert wording._missing_physics(diagnosis).startswith(said)


def test_the_parameters_of_these_tests_are_the_nominal_ones() -> None:
    """So that `nothing` is right, and not other parameters."""
    np.testing.assert_allclose([p.nominal for p in AS_IT_IS.parameters], PHI)
    assert SPOT.simulator.schema == AS_IT_IS.schema
