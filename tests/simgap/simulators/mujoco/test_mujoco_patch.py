"""The patched XML loads again and moves like the engine with what was found switched on."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from arms import URDF, arm, starts

from simgap.engines import Behind, split_as
from simgap.simulators.mujoco import MujocoEngine, Patched, Servos, load, patch
from simgap.simulators.mujoco.steps import stepped as with_steps

STEP = 0.02


def written(folder: Path, text: str, name: str = "arm.xml") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(text)
    return path


def again(folder: Path, patched: Patched) -> MujocoEngine:
    return load(written(folder, patched.xml, "robot.patched.xml"), STEP)


def some(engine: MujocoEngine) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    joints, commands = len(engine.machine.joints), len(engine.schema.command)
    state = 0.1 * rng.normal(size=(20, len(engine.schema.state)))
    return state, 0.5 * rng.normal(size=(20, engine.parts, commands)), np.zeros((20, joints))


def stepped_like(engine: MujocoEngine, other: MujocoEngine) -> MujocoEngine:
    return with_steps(engine, other.steps, other.parts, int(other.model.opt.integrator))


def same_rows(one: MujocoEngine, phi: np.ndarray, terms: np.ndarray, other: MujocoEngine) -> None:
    """Also where the other engine by itself would take steps of another length."""
    rows = some(one)
    other = stepped_like(other, one)
    expected = one.rows(phi, np.tile(terms, (20, 1)), *rows)
    got = other.rows(other.nominal, np.zeros((20, len(other.terms))), *rows)
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6)
    assert np.abs(expected - one.rows(one.nominal, np.zeros((20, len(terms))), *rows)).max() > 1e-3


DEFAULTS = """
  <default><default class="servo"><joint frictionloss=".05"/><position kp="99" forcerange="-50 50"/></default></default>
  <worldbody>"""


@pytest.mark.parametrize(
    "text", [arm(), arm(pan='class="servo"', servo='class="servo"').replace("<worldbody>", DEFAULTS)]
)
def test_the_patched_model_is_the_engine_with_what_was_found(tmp_path: Path, text: str) -> None:
    """All parameters and all terms at once, with and without default classes."""
    engine = load(written(tmp_path, text), STEP)
    phi = np.linspace(-0.6, 0.7, len(engine.parameters))
    terms = starts(engine)
    patched = patch(engine, phi, terms, tmp_path)
    assert not patched.unwritten
    same_rows(engine, phi, terms, again(tmp_path, patched))


def test_what_changed_in_words(tmp_path: Path) -> None:
    engine = load(written(tmp_path, arm()), STEP)
    phi, terms = engine.nominal.copy(), np.zeros(len(engine.terms))
    names = [p.name for p in engine.parameters]
    places = [(t.effect, t.where) for t in engine.terms]
    phi[names.index("kp pan")], phi[names.index("damping lift")] = np.log(0.5), np.log(2.0)
    for place, value in (
        (("coulomb_friction", "lift"), 0.3),
        (("payload", "hand"), 0.4),
        (("force_limit", "pan"), 0.5),
    ):
        terms[places.index(place)] = value
    patched = patch(engine, phi, terms, tmp_path)
    assert [str(c) for c in patched.changes] == [
        "actuator pan: kp 12 -> 6",
        "joint lift: damping 0.2 -> 0.4",
        "actuator lift: kv 0.5 -> 1",
        "joint lift: frictionloss 0 -> 0.3",
        "body hand: payload none -> a body payload_hand of mass 0.4 at 0.12 0 0",
        "actuator pan: forcerange none -> -2 2",
    ]
    assert '<position name="pan" joint="pan" forcelimited="true" forcerange="-2 2" kp="6"/>' in patched.xml


def test_nothing_found_changes_nothing(tmp_path: Path) -> None:
    engine = load(written(tmp_path, arm()), STEP)
    patched = patch(engine, engine.nominal, np.zeros(len(engine.terms)), tmp_path)
    assert patched.changes == ()
    rows = some(engine)
    other, none = again(tmp_path, patched), np.zeros((20, len(engine.terms)))
    np.testing.assert_array_equal(engine.rows(engine.nominal, none, *rows), other.rows(other.nominal, none, *rows))


def test_a_urdf_becomes_an_mjcf_with_its_servos(tmp_path: Path) -> None:
    engine = load(written(tmp_path, URDF, "two.urdf"), STEP, servos=Servos(kp=20.0, kv=0.5, force_limit=9.0))
    phi, terms = engine.nominal + 0.3, starts(engine, 1)
    same_rows(engine, phi, terms, again(tmp_path, patch(engine, phi, terms, tmp_path)))


def stepped(text: str, command: np.ndarray, hold: int) -> np.ndarray:
    """Positions of the first joint of MuJoCo's own steps, at the ends of rows."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    found = []
    for u in command:
        data.ctrl[0] = u
        mujoco.mj_step(model, data, nstep=hold)
        found.append(data.qpos[0])
    return np.array(found)


def test_a_delay(tmp_path: Path) -> None:
    """Commands act that much later: as if the same ones had been sent a row and a half later."""
    engine = load(written(tmp_path, arm()), STEP)
    patched = patch(engine, engine.nominal, np.zeros(len(engine.terms)), tmp_path, delays={"pan": 0.03})
    assert [str(c) for c in patched.changes] == ["actuator pan: delay 0 -> 0.03"]
    command = np.r_[0.0, np.repeat([0.5, -0.3, 0.2], 10)]
    fine = np.repeat(command, 2)
    later = np.r_[np.zeros(3), fine][: len(fine)]
    expected = stepped(arm(), later, 5)[1::2]
    np.testing.assert_allclose(stepped(patched.xml, command, 10), expected, atol=1e-6)


def test_a_lag(tmp_path: Path) -> None:
    engine = load(written(tmp_path, arm()), STEP)
    none = np.zeros(len(engine.terms))
    patched = patch(engine, engine.nominal, none, tmp_path, lags={"pan": 0.05})
    assert [str(c) for c in patched.changes] == ["actuator pan: dyntype none -> filterexact, time constant 0.05"]
    command = np.repeat([0.5, -0.3, 0.2], 10)
    slow, held = [], 0.0
    for u in np.repeat(command, 10):
        slow.append(held)
        held += (1 - np.exp(-0.002 / 0.05)) * (u - held)
    expected = stepped(arm(), np.array(slow), 1)[9::10]
    np.testing.assert_allclose(stepped(patched.xml, command, 10), expected, atol=1e-6)
    twice = patch(again(tmp_path, patched), engine.nominal, none, tmp_path, lags={"pan": 0.1})
    assert twice.unwritten == ("lag of 0.1 s at pan: the actuator has dynamics of its own",)


def test_springs_and_dampers_by_time_constant(tmp_path: Path) -> None:
    text = arm(pan='springdamper=".5 1"')
    engine = load(written(tmp_path, text), STEP)
    assert "stiffness pan" in [p.name for p in engine.parameters]
    phi = engine.nominal + 0.3
    none = np.zeros(len(engine.terms))
    same_rows(engine, phi, none, again(tmp_path, patch(engine, phi, none, tmp_path)))


@pytest.mark.filterwarnings("ignore:compiler attribute")
def test_a_payload_in_a_model_of_a_given_total_mass_is_not_written(tmp_path: Path) -> None:
    engine = load(written(tmp_path, arm().replace("<compiler", '<compiler settotalmass="3"')), STEP)
    terms = np.array([0.4 if t.effect == "payload" else 0.0 for t in engine.terms])
    patched = patch(engine, engine.nominal, terms, tmp_path)
    assert patched.changes == ()
    assert patched.unwritten == ("payload of 0.4 kg at hand: the model sets its total mass",)


def test_the_time_between_rows_is_not_written(tmp_path: Path) -> None:
    engine = load(written(tmp_path, arm()), STEP)
    terms = np.array([0.001 if t.effect == "sampling_interval" else 0.0 for t in engine.terms])
    patched = patch(engine, engine.nominal, terms, tmp_path)
    assert patched.changes == ()
    assert patched.unwritten == ("rows 0.021 s apart: that is a matter of the recordings",)


CUBE = """v 0 0 0
v .02 0 0
v 0 .02 0
v 0 0 .02
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


def test_meshes_are_found_from_another_folder(tmp_path: Path) -> None:
    assets = '<asset><mesh name="m" file="cube.obj"/></asset><worldbody>'
    text = arm(inside='<geom type="mesh" mesh="m" contype="0" conaffinity="0"/>').replace("<worldbody>", assets)
    text = text.replace("<compiler ", '<compiler meshdir="parts" ')
    path = written(tmp_path / "robot", text)
    written(tmp_path / "robot" / "parts", CUBE, "cube.obj")
    engine = load(path, STEP)
    terms = starts(engine)
    patched = patch(engine, engine.nominal, terms, tmp_path / "deep" / "found")
    same_rows(engine, engine.nominal, terms, again(tmp_path / "deep" / "found", patched))


DEGREES = """
  <default>
    <joint damping=".3" frictionloss=".02" armature=".004"/><default class="soft"><joint stiffness=".5"/></default>
  </default><worldbody>"""
ENDS = """
  <sensor><jointpos name="where" joint="lift"/></sensor>
  <equality><joint joint1="reach" joint2="lift" polycoef="0 .1 0 0 0"/></equality>
  <keyframe><key name="home" qpos=".1 .3 .03" qvel="1 2 .2" ctrl=".1 .2 0"/><key name="off" ctrl="0 0 1"/></keyframe>"""
MODELS = {
    "plain": arm(),
    "no armature": arm().replace('armature=".01" ', ""),
    "degrees and defaults": arm(hand='childclass="soft"').replace("<worldbody>", DEGREES)
    .replace('"radian"', '"degree"').replace('"-2 2"', '"-114 114"'),
    "other elements": arm(end=ENDS),
}  # fmt: skip


@pytest.mark.parametrize("text", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("effect", ["link_backlash", "elastic_joint"])
@pytest.mark.parametrize("form", ["link", "motor"])
def test_a_hidden_state_is_a_second_joint_that_moves_as_the_engine_did(
    text: str, effect: str, form: str, tmp_path: Path
) -> None:
    """By MuJoCo alone, over a few rows, with all other parameters changed too."""
    plain = load(written(tmp_path, text), STEP)
    rival = split_as(plain, Behind("lift", effect, form))
    phi, terms = np.linspace(-0.3, 0.4, len(rival.parameters)), starts(rival)
    patched = patch(rival, phi, terms, tmp_path)
    assert not patched.unwritten
    model = mujoco.MjModel.from_xml_string(patched.xml)
    assert model.opt.timestep <= rival.model.opt.timestep * (1 + 1e-9)
    model.opt.timestep, model.opt.integrator = STEP / rival.steps, mujoco.mjtIntegrator.mjINT_RK4
    model.opt.tolerance, model.opt.iterations = 1e-12, 200
    rows, command = 12, np.array([0.4, -0.3, 0.0])[: len(rival.schema.command)]
    path = rival.path(phi, terms, np.zeros(len(rival.schema.state)), np.tile(command, (rows + 1, 1)))
    data, measured = mujoco.MjData(model), []
    data.ctrl[: len(command)] = command
    for _ in range(rows):
        mujoco.mj_step(model, data, rival.steps)
        pan, lift, deflection = (data.joint(name).qpos[0] for name in ("pan", "lift", "lift_deflection"))
        measured.append([pan, lift + deflection if form == "link" else lift, deflection])
    columns = [[f.name for f in rival.schema.state].index(n) for n in ("pan_pos", "lift_pos", "lift_deflection")]
    np.testing.assert_allclose(measured, path[1:, columns], atol=2e-5)
    assert np.abs(path[:, columns[2]]).max() > 1e-3


def test_what_refers_to_a_split_joint_stays_valid(tmp_path: Path) -> None:
    rival = split_as(load(written(tmp_path, arm(end=ENDS)), STEP), Behind("lift", "link_backlash", "link"))
    terms = np.zeros(len(rival.terms))
    terms[-1] = 0.03
    patched = patch(rival, rival.nominal, terms, tmp_path)
    model = mujoco.MjModel.from_xml_string(patched.xml)
    np.testing.assert_allclose(model.key_qpos[0], [0.1, 0.3, 0.0, 0.03])
    np.testing.assert_allclose(model.key_qvel[0], [1, 2, 0, 0.2])
    np.testing.assert_allclose(model.key_ctrl, [[0.1, 0.2, 0], [0, 0, 1]])
    lift = model.joint("lift").id
    assert [model.sensor("where").objid[0], model.actuator("lift").trnid[0], model.eq_obj2id[0]] == [lift] * 3
    assert [str(c) for c in patched.changes] == [
        "joint lift: second joint none -> lift_deflection, range -0.015 0.015 rad; the measured position is lift + "
        "lift_deflection",
        "key home: qpos 3 values -> 0 for lift_deflection too",
        "key home: qvel 3 values -> 0 for lift_deflection too",
    ]


def test_a_rotor_without_inertia_and_long_steps_are_changed_for_a_second_joint(tmp_path: Path) -> None:
    text = arm().replace('armature=".01" ', "").replace('timestep="0.002"', 'timestep="0.01"')
    rival = split_as(load(written(tmp_path, text), STEP), Behind("lift", "elastic_joint", "motor"))
    terms = np.zeros(len(rival.terms))
    terms[-1] = 1 / 30
    patched = patch(rival, rival.nominal, terms, tmp_path)
    model, rotor = mujoco.MjModel.from_xml_string(patched.xml), rival.model.joint("lift").armature[0]
    assert model.joint("lift").armature[0] == pytest.approx(rotor, rel=1e-5)
    assert rotor > 0
    assert model.opt.timestep == pytest.approx(rival.model.opt.timestep)
    second, armature, timestep = map(str, patched.changes)
    assert second.startswith("joint lift: second joint none -> lift_deflection, stiffness 30 N m/rad, damping 0.")
    assert second.endswith(" N m s/rad; the measured position is lift")
    assert armature == f"joint lift: armature 0 -> {rotor:.6g}"
    assert timestep == f"option: timestep 0.01 -> {rival.model.opt.timestep:.6g}"
