"""Whole diagnoses: of a planted delay, of nothing, of a wrong parameter, and of physics that the vocabulary lacks."""

import json
from collections.abc import Callable
from functools import cache

import jax
import numpy as np
import pytest
from outside import SPOT, by_heading, by_speed_and_turn, unheard
from planted import PHI
from small import RICH, acting, sessions

from simgap.diagnosis.diagnose import Diagnosis, diagnose
from simgap.diagnosis.validation.calibration import probability
from simgap.diagnosis.validation.indicators import Indicators
from simgap.effects.augmented import Augmented
from simgap.recordings import split
from simgap.types import Recording, Sessions

pytestmark = pytest.mark.long


@cache
def delayed() -> Diagnosis:
    """1.4 rows of dead time on the base."""
    return diagnose(SPOT, "spot", Sessions(*sessions(acting("delay", (1.4,), (0, 1, 2)), RICH)))


@cache
def nothing() -> Diagnosis:
    return diagnose(SPOT, "spot", Sessions(*sessions({}, RICH)))


# A planted delay


def test_a_planted_delay_is_told() -> None:
    stated = delayed().statement
    assert stated["verdict"] == "missing_physics"
    (effect,) = stated["effects"]
    assert effect["id"] == "delay"
    assert effect["channels"] == ["cmd_base_vx", "cmd_base_vy", "cmd_base_wz"]
    assert effect["outputs"] == ["base_vx", "base_vy", "base_wz"]
    (constant,) = effect["constants"]
    assert constant["name"] == "delay"
    assert constant["unit"] == "s"
    assert constant["value"] == pytest.approx(1.4 / 15, rel=0.1)
    low, high = constant["ci95"]
    assert low - 0.002 < 1.4 / 15 < high + 0.002
    assert "dead time" in effect["statement"].lower()
    assert effect["statement"] in stated["statement"]


def test_a_planted_delay_is_credible_and_nothing_else_is() -> None:
    (effect,) = delayed().statement["effects"]
    assert effect["credible_set"] == ["delay"]
    assert effect["probability"] > 0.8  # on machines drawn at random 79 % of the delays found are delays
    assert effect["outside"] == pytest.approx(1 - effect["probability"], abs=0.01)
    assert effect["gain_nats"] > 100
    assert effect["heldout_gain_nats"] > 30
    for other in delayed().statement["alternatives"]:
        assert other["probability"] < 0.05


def test_heldout_sessions_improve() -> None:
    fit = delayed().statement["fit"]
    assert fit["heldout_sessions"] == ["s3"]
    assert set(fit["models"]) == {"nominal", "refitted", "augmented", "black_box"}
    before, after = fit["models"]["refitted"], fit["models"]["augmented"]
    assert after["nll_1"]["value"] < before["nll_1"]["value"] - 0.1
    for horizon in (1, 10, 50):
        assert after[f"error_{horizon}"]["value"] < before[f"error_{horizon}"]["value"]
    for scores in fit["models"].values():
        for score in scores.values():
            low, high = score["ci95"]
            assert low <= score["value"] <= high
    assert fit["explained_share"] is None or fit["explained_share"] > 0.5


def test_the_mismatch_is_where_the_delay_acts() -> None:
    located = delayed().statement["located"]
    moved = {"base_x", "base_y", "base_yaw", "base_vx", "base_vy", "base_wz", "ee_x", "ee_y", "ee_vx", "ee_vy"}
    assert {o["name"] for o in located["outputs"]} <= moved  # the hand is carried by the base
    assert {"base_vx", "base_wz"} <= {o["name"] for o in located["outputs"]}
    assert all(0 < o["excess"] <= 1 for o in located["outputs"])
    assert not located["intervals"]


def test_the_experiment_separates_the_delay_from_its_rival() -> None:
    stated, planned = delayed().statement["experiment"], delayed().experiment
    assert stated is not None
    assert planned is not None
    assert stated["separates"][0] == "delay"
    assert stated["separates"][1] != "delay"
    time_s, commands = planned
    assert commands.shape == (len(time_s), 6)
    np.testing.assert_allclose(np.diff(time_s), 1 / 15)
    assert np.abs(commands[:, :3]).max() > 0  # it moves the base
    recorded = np.max([np.abs(r.command).max(0) for r in sessions(acting("delay", (1.4,), (0, 1, 2)), RICH)[0]], axis=0)
    assert (np.abs(commands).max(0) <= recorded + 1e-6).all()


def test_the_model_is_the_augmented_simulator() -> None:
    model = delayed().model
    augmented = Augmented(SPOT)
    assert model.theta.shape == (len(augmented.slots),)
    assert np.flatnonzero(model.theta).tolist() == [0, 1, 2]  # the delays of the base's commands
    np.testing.assert_allclose(model.theta[:3], 1.4, rtol=0.1)
    np.testing.assert_allclose(model.phi[:3], PHI[:3], atol=0.05)
    assert all(np.isfinite(a).all() for a in (model.phi, model.gain, model.noise_scale, model.noise_dof))


# Its layout


@pytest.mark.parametrize("case", [delayed, nothing])
def test_the_statement_is_json_with_all_keys(case) -> None:
    stated = case().statement
    assert json.loads(json.dumps(stated, allow_nan=False)) == stated
    assert set(stated) >= {
        "schema", "simulator", "verdict", "located", "effects", "alternatives", "experiment", "parameters", "fit",
        "statement", "closest_matches", "whiteness",
    }  # fmt: skip
    assert stated["schema"] == 2
    assert stated["simulator"] == "spot"
    for effect in stated["found"]:
        assert effect["named"] == (effect["id"] in [e["id"] for e in stated["effects"]])
        assert effect["outside"] == 1 - probability(Indicators(**effect["indicators"]))
    assert set(stated["located"]) >= {"outputs", "regimes", "intervals"}
    assert set(stated["parameters"]) >= {"nominal", "fitted"}
    assert set(stated["fit"]) >= {"heldout_sessions", "models", "explained_share"}
    names = [p.name for p in SPOT.parameters]
    assert list(stated["parameters"]["nominal"]) == list(stated["parameters"]["fitted"]) == names
    for effect in stated["effects"]:
        assert set(effect) >= {
            "id", "probability", "channels", "outputs", "statement", "constants", "credible_set", "gain_nats",
        }  # fmt: skip
        for constant in effect["constants"]:
            assert set(constant) == {"name", "value", "unit", "ci95"}


@pytest.mark.parametrize("case", [delayed, nothing])
def test_all_rows_of_the_pictures_have_their_sizes(case) -> None:
    evidence = case().evidence
    heat = evidence["heat"]
    assert heat["values"].shape == (len(heat["outputs"]), len(heat["regimes"]))
    assert [s["session"] for s in evidence["strips"]] == ["s0", "s1", "s2", "s3"]
    for strip in evidence["strips"]:
        assert len(strip["time_s"]) == len(strip["excess"])
        assert np.isfinite(strip["excess"]).all()


# Nothing, and a parameter


def test_where_nothing_is_missing_nothing_is_claimed() -> None:
    stated = nothing().statement
    assert stated["verdict"] == "nothing"
    assert stated["effects"] == []
    assert stated["alternatives"] == []
    assert stated["experiment"] is None
    assert nothing().experiment is None
    assert stated["located"]["outputs"] == stated["located"]["regimes"] == stated["located"]["intervals"] == []
    assert not nothing().model.theta.any()
    assert "nothing is missing" in stated["statement"].lower()


def test_a_wrong_parameter_is_told_as_such() -> None:
    phi = PHI.copy()
    phi[0], phi[20] = 0.15, 1.5
    stated = diagnose(SPOT, "spot", Sessions(*sessions({}, RICH, phi=phi))).statement
    assert stated["verdict"] == "parameters_only"
    assert stated["effects"] == []
    nominal, fitted = stated["parameters"]["nominal"], stated["parameters"]["fitted"]
    assert nominal["alpha_1"] == pytest.approx(0.5)
    assert fitted["alpha_1"] == pytest.approx(0.15, abs=0.05)
    assert fitted["gamma_3"] == pytest.approx(1.5, abs=0.05)
    low, high = stated["parameters"]["ci95"]["gamma_3"]
    assert low - 0.02 < 1.5 < high + 0.02


# Outside of the vocabulary


@cache
def nameless(law: Callable[[jax.Array], jax.Array]) -> Diagnosis:
    recorded = unheard(law, RICH)
    return diagnose(SPOT, "spot", Sessions(recorded[:-1], recorded[-1:]))


@pytest.mark.parametrize(("law", "outputs"), [(by_heading, {"ee_x", "ee_vx"}), (by_speed_and_turn, {"ee_z", "ee_vz"})])
def test_physics_outside_of_the_vocabulary_gets_no_confident_name(law: Callable, outputs: set[str]) -> None:
    stated = nameless(law).statement
    assert stated["verdict"] == "unexplained"
    assert stated["effects"] == []
    assert outputs & {o["name"] for o in stated["located"]["outputs"]}


def test_what_has_no_name_is_told_by_what_it_leaves_over_and_depends_on() -> None:
    """Of by_heading; the hand's memory along z, refitted, foretells by_speed_and_turn as far as its past does."""
    stated = nameless(by_heading).statement
    assert {o["name"] for o in stated["whiteness"]["outputs"]} & {"ee_x", "ee_vx", "ee_y", "ee_vy"}
    assert stated["located"]["depends_on"]


# Sessions


def recording(name: str, rows: int = 8) -> Recording:
    return Recording(name, np.arange(rows) / 15, np.tile(np.arange(rows)[:, None], (1, 12)), np.zeros((rows, 6)))


@pytest.mark.parametrize(
    ("count", "heldout"), [(2, "1"), (3, "2"), (4, "3"), (5, "3"), (7, "3"), (8, "37"), (12, "37b")]
)
def test_every_fourth_session_is_held_out(count: int, heldout: str) -> None:
    names = "0123456789ab"[:count]
    training, held = split([recording(n) for n in names])
    assert "".join(r.name for r in held) == heldout
    assert [r.name for r in training] == [n for n in names if n not in heldout]


def test_of_a_single_session_the_last_quarter_is_held_out() -> None:
    (training,), (held,) = split([recording("a", 40)])
    assert len(training.time_s) == 30
    assert len(held.time_s) == 10
    assert training.name != held.name
    np.testing.assert_array_equal(np.concatenate([training.state, held.state])[:, 0], np.arange(40))
