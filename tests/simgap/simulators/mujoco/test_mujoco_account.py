"""What a diagnosis says of a model file: where it started, and what of its findings is written into the model."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from examples.arm import JOINTS, MODEL
from simgap.effects.augmented import Augmented
from simgap.engines import Behind, Engine, split_as
from simgap.simulators.mujoco import MujocoEngine, load, rescaled
from simgap.simulators.mujoco.account import account, patched
from simgap.simulators.mujoco.servo_errors import servo_errors
from simgap.types import Recording

STEP = 0.02
KP = [f"kp {joint}" for joint in JOINTS]
RESTING = [Recording("level", np.arange(30) * STEP, np.zeros((30, 6)), np.zeros((30, 3)))]
"""The arm stretched out level, where its weight pulls most."""


@pytest.fixture(scope="module")
def engine() -> MujocoEngine:
    return load(MODEL, STEP)


def statement(engine: MujocoEngine, verdict: str, **more: Any) -> dict[str, Any]:
    """What the account reads of a diagnosis that left the parameters where it started."""
    values = {p.name: p.nominal for p in engine.parameters}
    ends = {name: [value, value] for name, value in values.items()}
    parameters = {"nominal": values, "fitted": values, "ci95": ends, "ranges": ends}
    seen = {"effects": [], "power": 0.9, "imitated_effects": []}
    return {"verdict": verdict, "statement": "Nothing.", "warnings": [], "notes": [], "effects": [],
            "closest_matches": [], "parameters": parameters, "sensitivity": seen, **more}  # fmt: skip


def model(engine: MujocoEngine, **terms: float) -> Any:
    """The constants of a diagnosis; terms by effect and place, `coulomb_friction_pan=0.3`."""
    augmented = Augmented(cast(Engine, engine))
    theta = np.zeros(len(augmented.slots), np.float32)
    for i, slot in enumerate(augmented.slots):
        effect, site = augmented.catalogue[slot.effect], augmented.sites[slot.effect][slot.site]
        theta[i] = terms.pop(f"{effect.id}_{site.name}", 0.0) if effect.place == "engine" else 0.0
    assert not terms
    return SimpleNamespace(phi=engine.nominal, theta=theta)


def test_a_model_that_is_off_by_far_is_said_before_all_else(engine: MujocoEngine) -> None:
    nearer = rescaled(engine, dict.fromkeys(KP, 1 / 110))
    result = account(nearer, model(nearer), statement(nearer, "nothing"), "arm.patched.xml", RESTING)
    words = "The model's position servos are about 110 times too stiff (kp)."
    assert result["verdict"] == "parameters_only"
    assert [result[key][0].startswith(words) for key in ("warnings", "notes")] == [True, True]
    assert result["statement"].startswith(
        f"{words} The diagnosis takes the model with kp divided by 110 as the nominal"
    )
    assert "parameters were off and are refitted" in result["statement"]
    assert result["parameters"]["nominal"]["kp pan"] == 60
    assert result["parameters"]["fitted"]["kp pan"] == pytest.approx(60 / 110)
    kp = {c["element"]: float(c["after"]) for c in result["patched"]["changes"]}
    assert kp == pytest.approx(
        {f"actuator {a}": k / 110 for a, k in (("pan", 60), ("shoulder", 80), ("elbow", 40))}, rel=1e-4
    )


def test_a_model_that_is_not_stays_what_it_was_said_to_be(engine: MujocoEngine) -> None:
    result = account(engine, model(engine), statement(engine, "nothing"), "arm.patched.xml", RESTING)
    assert (result["verdict"], result["statement"], result["warnings"], result["notes"]) == (
        "nothing",
        "Nothing.",
        [],
        [],
    )
    assert result["patched"] is None


def test_parameters_that_were_off_are_named_in_their_units(engine: MujocoEngine) -> None:
    said = statement(engine, "parameters_only")
    names = list(said["parameters"]["nominal"])
    said["parameters"] |= {
        "fitted": dict.fromkeys(names, 0.02) | {"kp shoulder": np.log(0.7)},
        "ci95": {n: [-0.1, 0.1] for n in names} | {"kp shoulder": [np.log(0.69), np.log(0.71)]},
        "ranges": {n: [-1.0, 1.0] for n in names},
    }
    words = account(engine, model(engine), said, "arm.patched.xml", RESTING)["statement"]
    assert "were off and are refitted: kp shoulder is 56 N m/rad, not 80 N m/rad. With" in words


def effect(id: str, where: str, outputs: list[str], **more: Any) -> dict[str, Any]:
    return {"id": id, "form": "", "where": where, "outputs": outputs, "channels": [], "constants": [],
            "support": {"kind": "always"}, "statement": f"{id} on {where}.", **more}  # fmt: skip


def test_another_form_of_an_effect_than_the_engine_s_own_is_listed_as_unwritten(engine: MujocoEngine) -> None:
    """MuJoCo computes a constant time between rows, but no uneven ones."""
    uneven = effect("sampling_interval", "all", ["pan_pos"], form="stamped")
    written = patched(engine, model(engine), statement(engine, "missing_physics", effects=[uneven]), Path())
    assert written.unwritten == ("sampling_interval on all. MJCF cannot express it.",)


def test_only_named_effects_are_written(engine: MujocoEngine) -> None:
    """Of one id some may be named and others not; what is not written is listed with the reason."""
    named = effect("coulomb_friction", "pan", ["pan_pos", "pan_vel"])
    matches = [
        effect("coulomb_friction", "elbow", ["elbow_pos", "elbow_vel"]),
        effect("payload", "forearm", [f"{j}_{what}" for j in JOINTS for what in ("pos", "vel")]),
        effect("delay", "cmd_pan", [], channels=["cmd_pan"], constants=[{"name": "delay", "value": 0.03}]),
    ]
    result = account(
        engine,
        model(engine, coulomb_friction_pan=0.3, coulomb_friction_elbow=0.2, payload_forearm=0.4),
        statement(engine, "missing_physics", effects=[named], closest_matches=matches),
        "arm.patched.xml",
        RESTING,
    )
    changes = [(c["element"], c["attribute"], c["after"]) for c in result["patched"]["changes"]]
    assert changes == [("joint pan", "frictionloss", "0.3")]
    assert result["patched"]["unwritten"] == [
        f"{m['statement']} It is a closest match, which explains only part of the mismatch: its name is not certain."
        for m in matches
    ]


def test_an_effect_that_joints_share_is_written_at_each(engine: MujocoEngine) -> None:
    shared = effect("coulomb_friction", "pan, elbow", ["pan_pos", "pan_vel", "elbow_pos", "elbow_vel"])
    late = effect("delay", "cmd_pan", [], channels=["cmd_pan"], constants=[{"name": "delay", "value": 0.03}])
    result = account(
        engine,
        model(engine, coulomb_friction_pan=0.3, coulomb_friction_elbow=0.3, coulomb_friction_shoulder=0.1),
        statement(engine, "missing_physics", effects=[shared, late]),
        "arm.patched.xml",
        RESTING,
    )
    changes = [(c["element"], c["attribute"], c["after"]) for c in result["patched"]["changes"]]
    assert changes == [
        ("joint pan", "frictionloss", "0.3"), ("joint elbow", "frictionloss", "0.3"), ("actuator pan", "delay", "0.03"),
    ]  # fmt: skip


def test_of_several_hidden_states_the_one_of_the_model_is_written(engine: MujocoEngine) -> None:
    with_it = cast(MujocoEngine, split_as(cast(Engine, engine), Behind("shoulder", "link_backlash", "link")))
    effects = [effect("link_backlash", joint, [f"{joint}_pos", f"{joint}_vel"], form="link", parameters=[])
               for joint in ("shoulder", "elbow")]  # fmt: skip
    said = statement(with_it, "missing_physics", effects=effects)
    found = account(with_it, model(with_it, link_backlash_shoulder=0.03), said, "arm.patched.xml", RESTING)
    assert [(c["element"], c["attribute"], c["after"].partition(",")[0]) for c in found["patched"]["changes"]] == [
        ("joint shoulder", "second joint", "shoulder_deflection")
    ]
    assert found["patched"]["unwritten"] == [
        "link_backlash on elbow. It was fitted without the one before it: a model has one hidden state."
    ]


def test_what_changed_since_a_baseline_is_written_for_the_machine_is_as_it_is_now(engine: MujocoEngine) -> None:
    since = {"channels": ["cmd_pan"], "constants": [{"name": "delay", "value": 0.03}]}
    late = effect("delay", "cmd_pan", [], support={"kind": "since_baseline"}, **since)
    found = account(
        engine, model(engine), statement(engine, "missing_physics", effects=[late]), "arm.patched.xml", RESTING
    )
    assert [c["attribute"] for c in found["patched"]["changes"]] == ["delay"]
    assert found["patched"]["unwritten"] == []


def test_what_mjcf_has_no_word_for_is_listed_with_the_reason(engine: MujocoEngine) -> None:
    effects = [
        effect("backlash", "cmd_pan", []),
        effect("delay", "cmd_pan", [], support={"kind": "from", "from_s": 3.0}),
    ]
    result = account(
        engine, model(engine), statement(engine, "missing_physics", effects=effects), "arm.patched.xml", RESTING
    )
    assert result["patched"]["changes"] == []
    assert result["patched"]["unwritten"] == [
        "backlash on cmd_pan. MJCF cannot express it.",
        "delay on cmd_pan. MJCF can only express effects that always act.",
    ]


def test_servos_sag_by_the_load_over_their_stiffness(engine: MujocoEngine) -> None:
    """Links of 0.8 and 0.5 kg, whose middles are 0.125 and 0.35 m from the shoulder."""
    phi = engine.nominal.copy()
    phi[[p.name for p in engine.parameters].index("kp shoulder")] = np.log(0.25)
    pan, shoulder, elbow = servo_errors(engine, phi, np.zeros(len(engine.terms)), RESTING)
    load = 9.81 * (0.8 * 0.125 + 0.5 * 0.35)
    assert (pan.load, pan.sag) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert (shoulder.load, shoulder.nominal_sag, shoulder.sag) == pytest.approx((load, load / 80, load / 20), rel=1e-3)
    assert (elbow.load, elbow.sag) == pytest.approx((9.81 * 0.05, elbow.nominal_sag), rel=1e-3)


def test_a_servo_is_behind_a_steady_command_by_its_damping_over_its_stiffness(engine: MujocoEngine) -> None:
    rate = np.array([0.5, 0.0, 0.0])
    command = rate * STEP * np.arange(100)[:, None]
    path = engine.path(engine.nominal, np.zeros(len(engine.terms)), np.zeros(6), command)
    pan = servo_errors(engine, engine.nominal, np.zeros(len(engine.terms)), RESTING)[0]
    held = STEP / 2  # commands are held for a row: in the mean they are half a row old
    assert (command[-1, 0] - path[-1, 0]) / 0.5 == pytest.approx(pan.lag + held, rel=0.01)


def test_the_statement_says_which_servos_sag_or_lag_otherwise_than_in_the_model(engine: MujocoEngine) -> None:
    nearer = rescaled(engine, dict.fromkeys(KP, 1 / 20))
    said = account(nearer, model(nearer), statement(nearer, "nothing"), "arm.patched.xml", RESTING)
    assert said["statement"].endswith(
        "At rest, servos sag under the weight that they hold: shoulder by 670 mrad (34 mrad in the model), elbow by "
        "250 mrad (12 mrad in the model). The others (pan) sag as in the model. In steady motion, servos are behind "
        "their commands: pan by 1000 ms (50 ms in the model), shoulder by 750 ms (38 ms in the model), elbow by 750 ms "
        "(38 ms in the model)."
    )
    assert [s["joint"] for s in said["servo_errors"]] == list(JOINTS)
    as_it_is = account(engine, model(engine), statement(engine, "missing_physics"), "arm.patched.xml", RESTING)
    assert "sag" not in as_it_is["statement"]


def test_gravity_compensation_takes_load_off_servos(engine: MujocoEngine) -> None:
    terms = np.array([0.5 if t.effect == "joint_gravity" else 0.0 for t in engine.terms])
    whole, half = (servo_errors(engine, engine.nominal, t, RESTING) for t in (0 * terms, terms))
    assert [s.load for s in half] == pytest.approx([s.load / 2 for s in whole], abs=1e-6)
