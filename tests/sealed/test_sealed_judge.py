"""What counts as right and wrong in a sealed suite, on statements made up for it."""

import math
from typing import Any

import numpy as np
import pytest

from tasks.sealed import metrics
from tasks.sealed.judge import judge, overlap, rows_of, set_f1


def key(kind: str, *effects: str, strength: float = 100.0, **more: Any) -> dict[str, Any]:
    verdicts = {"null": ["nothing", "parameters_only"], "outside": ["unexplained"]}.get(kind, ["missing_physics"])
    return {
        "kind": kind, "strength": strength, "target": strength, "when": None, "verdicts": verdicts,
        "effects": [{"id": e, "accept": [e, *more.get("also", ())], "channels": [], "outputs": ["base_vx"],
                     "constants": [{"name": "limit", "value": 0.5, "unit": "m/s"}]} for e in effects],
        "recipe": {"size": "usual", "poor": False, "level": 1.0, "outliers": False, "wild": False},
        "error_50": {"true": 0.06, "refitted": 0.1},
    }  # fmt: skip


def effect(name: str, probability: float = 0.99, credible: tuple[str, ...] = (), gain: float = 50.0) -> dict[str, Any]:
    return {"id": name, "probability": probability, "credible_set": [name, *credible], "gain_nats": gain,
            "outputs": ["base_vx", "base_vy"], "channels": [], "support": {"from_s": None},
            "constants": [{"name": "limit", "value": -0.52, "unit": "m/s", "ci95": [-0.55, -0.49]}]}  # fmt: skip


def stated(verdict: str, *effects: dict[str, Any], augmented: float | None = None) -> dict[str, Any]:
    models = {"refitted": 0.2, "black_box": 0.18, **({"augmented": augmented} if augmented else {})}
    return {"verdict": verdict, "effects": list(effects), "located": {"regimes": []},
            "fit": {"models": {m: {"error_50": {"value": v}} for m, v in models.items()}}}  # fmt: skip


def row(key: dict[str, Any], stated: dict[str, Any] | None, error: str | None = None) -> dict[str, Any]:
    found = {"case": "0", **judge(key, stated, 1.0, error)}
    return {**found, "fault": metrics.fault(found)}


@pytest.mark.parametrize(
    ("truth", "said", "fault"),
    [
        (key("null"), stated("parameters_only"), ""),
        (key("null"), stated("inconclusive"), ""),
        (key("null"), stated("unexplained"), "false alarm"),
        (key("null"), stated("missing_physics", effect("gain")), "false alarm"),
        (key("single", "saturation"), stated("missing_physics", effect("saturation")), ""),
        (key("single", "gain", also=("viscous_drag",)), stated("missing_physics", effect("viscous_drag")), ""),
        (key("single", "saturation"), stated("missing_physics", effect("gain")), "surely wrong"),
        (key("single", "saturation"), stated("missing_physics", effect("gain", 0.6)), "wrong name"),
        (key("single", "saturation"), stated("missing_physics", effect("gain", 0.96, ("saturation",))), "wrong name"),
        (key("single", "saturation"), stated("nothing"), "nothing said"),
        (key("single", "saturation", strength=3.0), stated("nothing"), ""),
        (key("pair", "lag", "slip"), stated("missing_physics", effect("lag"), effect("slip")), ""),
        (key("pair", "lag", "slip"), stated("missing_physics", effect("lag")), "wrong set"),
        (key("outside", "magnet"), stated("unexplained"), ""),
        (key("outside", "magnet"), stated("missing_physics", effect("lag")), "name beyond words"),
        (key("outside", "magnet"), stated("parameters_only"), "not seen"),
        (key("single", "lag"), None, "nothing said"),
    ],
)
def test_faults(truth: dict[str, Any], said: dict[str, Any] | None, fault: str) -> None:
    assert row(truth, said)["fault"] == fault


def test_a_case_that_broke_off_comes_first() -> None:
    broken = row(key("null"), None, "killed")
    wolf = row(key("null"), stated("unexplained"))
    assert [r["fault"] for r in metrics.failures([wolf, broken])] == ["broke off", "false alarm"]


def test_the_first_name_is_the_one_that_gains_most() -> None:
    said = stated("missing_physics", effect("gain", gain=10.0), effect("saturation", gain=90.0))
    found = row(key("single", "saturation"), said)
    assert found["top1"]
    assert not found["alone"]
    assert found["extra"] == 1


def test_a_declared_tie_is_counted_by_itself() -> None:
    """A name that is given at even odds with the right one; at odds of six to one it is a wrong name, not a tie."""
    lag = key("single", "lag")
    names = [("lag", 0.99, (), (True, True)), ("delay", 0.5, ("lag",), (False, True)),
             ("delay", 0.85, ("lag",), (False, False)), ("delay", 0.5, ("gain",), (False, False))]  # fmt: skip
    for name, probability, alternatives, counts in names:
        said = effect(name, probability, alternatives)
        found = row(lag, stated("missing_physics", said))
        assert (found["top1"], found["tied"]) == counts
        # That its cause may be another one makes a name no tie.
        doubted = said | {"probability": 0.7 * probability, "outside": 0.3}
        assert row(lag, stated("missing_physics", doubted))["tied"] == counts[1]
    two = row(key("pair", "lag", "slip"), stated("missing_physics", effect("delay", 0.5, ("lag",)), effect("slip")))
    assert (two["set_f1"], two["set_f1_tied"]) == (0.5, 1.0)
    both = row(key("pair", "lag", "slip"), stated("missing_physics", effect("delay", 0.5, ("lag", "slip"))))
    assert both["set_f1_tied"] == pytest.approx(2 / 3), "one effect is one hit, however many names it has"


def test_a_right_name_at_another_joint_is_not_alone() -> None:
    """Where the key says which commands an effect acts on; one at all of them may be told joint by joint."""

    def at(*joints: str) -> dict[str, Any]:
        return {**effect("friction"), "channels": [f"cmd_{joint}" for joint in joints]}

    everywhere, truth = key("single", "friction"), key("single", "friction")
    truth["effects"][0]["channels"] = ["cmd_elbow"]
    for said, here, anywhere in (((at("elbow"),), True, True), ((at("elbow"), at("base")), False, True),
                                 ((at("elbow", "base"),), False, True), ((at("elbow"), effect("lag")), False, False),
                                 ((), False, False)):  # fmt: skip
        assert row(truth, stated("missing_physics", *said))["alone"] == here
        assert row(everywhere, stated("missing_physics", *said))["alone"] == anywhere
    assert row(truth, stated("missing_physics", at("elbow"), at("base")))["fault"] == "further name"


def test_a_wrong_parameter_is_refitted_and_named_nothing() -> None:
    truth = {**key("parameters"), "verdicts": ["parameters_only"], "cause": "wrong kp", "parameter": ("kp elbow", 50.0)}
    said = {**stated("parameters_only"), "parameters": {"fitted": {"kp elbow": 48.0}}}
    found = row(truth, said)
    assert found["parameter_error"] == pytest.approx(0.04)
    assert (found["truth"], found["fault"], found["confident_wrong"]) == ("wrong kp", "", False)
    assert row(truth, stated("nothing"))["fault"] == "not seen"
    wrong = row(truth, stated("missing_physics", effect("gain")))
    assert (wrong["fault"], wrong["confident_wrong"]) == ("false alarm", True)


def test_errors_in_open_loop_are_in_terms_of_the_noise() -> None:
    """Of the model with the effects, or refitted where none is named."""
    truth, errors = {**key("single", "lag"), "floor": 2e-4}, {"nominal": 8e-4, "refitted": 6e-4, "augmented": 2e-4}
    replay = {"positions": [{"name": "a_pos", "errors": errors}, {"name": "b_pos", "errors": errors}]}
    found = row(truth, {**stated("missing_physics", effect("lag")), "replay": replay})
    assert (found["open_loop"], found["open_loop_nominal"]) == (pytest.approx(1.0), pytest.approx(4.0))
    for position in replay["positions"]:
        position["errors"] = {name: e for name, e in errors.items() if name != "augmented"}
    assert row(truth, {**stated("parameters_only"), "replay": replay})["open_loop"] == pytest.approx(3.0)
    assert "open_loop" not in row(truth, {**stated("nothing"), "replay": None})
    assert "open_loop" not in row(key("single", "lag"), {**stated("nothing"), "replay": replay})


def test_constants_are_compared_by_size_and_their_interval_by_either_sign() -> None:
    found = row(key("single", "saturation"), stated("missing_physics", effect("saturation")))
    assert found["constant_error"] == pytest.approx(0.04)
    assert found["constant_held"]
    assert found["outputs_f1"] == pytest.approx(2 / 3)


def test_the_share_of_the_improvement_is_of_what_the_true_form_makes() -> None:
    found = row(key("single", "lag"), stated("missing_physics", effect("lag"), augmented=0.14))
    assert found["share"] == pytest.approx(0.3 / 0.4)
    assert found["share_black_box"] == pytest.approx(0.1 / 0.4)
    assert "share" not in row(key("null"), stated("nothing"))


def test_f1_of_sets() -> None:
    assert set_f1([{"a"}, {"b", "c"}], [{"c"}, {"a"}]) == 1.0
    assert set_f1([{"a"}, {"b"}], [{"a"}]) == pytest.approx(2 / 3)
    assert set_f1([{"a"}, {"a"}], [{"a"}, {"a"}]) == 1.0
    assert set_f1([{"a"}], [{"a"}, {"b"}, {"d"}]) == 0.5


def test_regimes_overlap_by_rows() -> None:
    reach = {"reach": np.linspace(0, 1, 101)}
    assert overlap("reach > 0.5 m", ["reach > 0.75 m", "reach < 0.1 m"], reach) == pytest.approx(0.5, abs=0.02)
    assert overlap("reach > 0.5 m", [], reach) == 0.0
    assert rows_of("|cmd_base_vx| < 1e-2 m/s", {"|cmd_base_vx|": np.array([0.0, 0.02])}) is not None
    assert rows_of("mood > 3", reach) is None


def test_intervals_of_shares() -> None:
    low, high = metrics.wilson(0, 200)
    assert (low, high) == (0.0, pytest.approx(0.0188, abs=1e-3))
    assert metrics.wilson(50, 100) == (pytest.approx(0.404, abs=2e-3), pytest.approx(0.596, abs=2e-3))
    assert all(math.isnan(v) for v in metrics.wilson(0, 0))


def test_the_table_counts_each_kind_by_itself() -> None:
    rows = [
        row(key("null"), stated("nothing")), row(key("null"), stated("unexplained")),
        row(key("single", "lag"), stated("missing_physics", effect("lag"))),
        row(key("single", "lag", strength=10.0), stated("nothing")),
        row(key("duel", "lag"), stated("missing_physics", effect("delay"))),
        row(key("outside", "magnet"), stated("missing_physics", effect("lag"))),
    ]  # fmt: skip
    table = metrics.table(rows, np.random.default_rng(0))
    assert metrics.headline(table) == {"false_alarms": 0.5, "right_name": 1.0, "sure_wrong": 1 / 3}
    found = {s.name: (s.value, s.n) for s in table}
    assert found["false alarms on nulls"] == (0.5, 2)
    assert found["top-1, 30 nats and more"] == (1.0, 1)
    assert found["top-1, 10 nats"] == (0.0, 1)
    assert found["confident-wrong on duels"] == (1.0, 1)
    assert found["wrong names outside the vocabulary"] == (1.0, 1)
    assert "set F1, pairs" not in found  # no score of kinds that the suite does not have
    bins = metrics.power(rows)
    assert [(b["n"], b["right"]) for b in bins] == [(0, 0.0), (1, 0.0), (0, 0.0), (2, 0.5), (0, 0.0)]
