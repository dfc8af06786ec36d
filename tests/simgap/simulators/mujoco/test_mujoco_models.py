"""Models as people have them: what of them can be diagnosed is, and the rest is named."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from arms import arm

from simgap.engines import no_effort
from simgap.simulators.mujoco import MujocoEngine, load
from simgap.simulators.mujoco.steps import stepped as with_steps
from simgap.types import SimgapError

STEP = 0.02


def loaded(folder: Path, text: str, columns: set[str] | None = None) -> MujocoEngine:
    path = folder / "model.xml"
    path.write_text(text)
    return load(path, STEP, columns)


def after(engine: MujocoEngine, state: list[float], command: list[float]) -> np.ndarray:
    """One row, without terms."""
    u = np.tile(command, (1, engine.parts, 1))
    no_terms = np.zeros((1, len(engine.terms)))
    return engine.rows(engine.nominal, no_terms, np.array([state]), u, no_effort(engine, 1))[0]


def stepped_like(engine: MujocoEngine, other: MujocoEngine) -> MujocoEngine:
    return with_steps(engine, other.steps, other.parts, int(other.model.opt.integrator))


def step_like(engine: MujocoEngine, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """One row of MuJoCo's own steps, as long as the engine's and by the same rule."""
    model.opt.timestep, model.opt.integrator = engine.model.opt.timestep, engine.model.opt.integrator
    mujoco.mj_step(model, data, nstep=engine.steps)


BOX = '<body name="box" pos="1 0 1"><freejoint name="loose"/><geom size=".1"/></body>'
BALL = '<body name="bob" pos="0 1 1"><joint name="round" type="ball"/><geom size=".1" pos=".3 0 0"/></body>'


def test_ball_joints_and_free_joints_without_a_column_are_held_and_named(tmp_path: Path) -> None:
    recorded = {f"{joint}_{what}" for joint in ("pan", "lift", "reach") for what in ("pos", "vel")}
    commands = {"cmd_pan", "cmd_lift", "cmd_push"}
    engine = loaded(tmp_path, arm().replace("</worldbody>", BOX + BALL + "</worldbody>"), recorded | commands)
    free, ball = engine.notes
    assert free.startswith("the free joint loose is held still and not diagnosed: there is no column")
    assert "loose_x_pos" in free
    assert ball == "the ball joint round is held still and not diagnosed"
    plain = stepped_like(load(_written(tmp_path, arm()), STEP), engine)
    state, command = [0.3, 0.2, 0.01, 0.5, -1.0, 0.0], [0.1, -0.2, 0.3]
    np.testing.assert_allclose(after(engine, state, command), after(plain, state, command), atol=1e-9)


def _written(folder: Path, text: str, name: str = "plain.xml") -> Path:
    (folder / name).write_text(text)
    return folder / name


def test_a_joint_without_a_column_is_held_at_the_keyframe(tmp_path: Path) -> None:
    """The joint above it then moves as if it were part of it."""
    key = '<keyframe><key qpos="0 .7 0" ctrl="0 .7 0"/></keyframe>'
    engine = loaded(tmp_path, arm(end=key), {"pan_pos", "pan_vel", "reach_pos", "reach_vel", "cmd_pan", "cmd_lift"})
    assert engine.schema.columns == ("time_s", "pan_pos", "reach_pos", "pan_vel", "reach_vel", "cmd_pan")
    assert engine.notes == (
        "the joint lift has no column lift_pos; it is held still and not diagnosed",
        "the control of the actuator lift stays at its reference value: the position of its joint is not recorded",
        "the control of the actuator push stays at its reference value: there is no column cmd_push",
    )
    welded = arm().replace('<body name="fore" pos=".2 0 0">', '<body name="fore" pos=".2 0 0" euler="0 .7 0">')
    welded = welded.replace('<joint name="lift" axis="0 1 0" range="-2 2" damping=".2" armature=".01" />', "")
    welded = welded.replace('<position name="lift" joint="lift" kp="20" kv=".5"/>', "")
    other = stepped_like(load(_written(tmp_path, welded), STEP), engine)
    state = [0.3, 0.01, 0.5, 0.02]
    np.testing.assert_allclose(after(engine, state, [0.1]), after(other, state, [0.1, 0.0]), rtol=1e-6, atol=1e-9)
    assert not [name for name in (p.name for p in engine.parameters) if "lift" in name]


def test_recordings_of_no_joint(tmp_path: Path) -> None:
    with pytest.raises(SimgapError, match="need a column <joint>_pos for at least one of: pan, lift, reach"):
        loaded(tmp_path, arm(), {"time_s", "cmd_pan"})
    with pytest.raises(SimgapError, match="at least one of: loose_x, loose_y, loose_z, loose_yaw"):
        loaded(tmp_path, f"<mujoco><worldbody>{BOX}</worldbody></mujoco>", {"time_s"})
    with pytest.raises(SimgapError, match="the model has no joint but ball joints"):
        loaded(tmp_path, f"<mujoco><worldbody>{BALL}</worldbody></mujoco>")


FINGERS = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="wrist">
      <joint name="turn" axis="0 0 1" damping="1"/>
      <geom size=".05" mass=".3"/>
      <body name="left" pos=".1 .05 0"><joint name="left" type="slide" axis="0 1 0" damping="5"/>
        <geom size=".01" mass=".1"/></body>
      <body name="right" pos=".1 -.05 0"><joint name="right" type="slide" axis="0 -1 0" damping="5"/>
        <geom size=".01" mass=".1"/></body>
    </body>
  </worldbody>
  <tendon><fixed name="split"><joint joint="left" coef=".5"/><joint joint="right" coef=".5"/></fixed></tendon>
  <equality><joint joint1="right" joint2="left"/></equality>
  <actuator><position joint="turn" kp="20"/><position name="grip" tendon="split" kp="100"/></actuator>
</mujoco>
"""


def test_a_joint_that_an_equality_constraint_moves_follows(tmp_path: Path) -> None:
    engine = loaded(tmp_path, FINGERS)
    assert engine.notes == ("the joint right follows left by an equality constraint",)
    assert engine.schema.columns == ("time_s", "turn_pos", "left_pos", "turn_vel", "left_vel", "cmd_turn", "cmd_grip")
    model = mujoco.MjModel.from_xml_string(FINGERS)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = [0.2, 0.01, 0.01], [0.5, 0.1, 0.1], [0.0, 0.03]
    step_like(engine, model, data)
    expected = [*data.qpos[:2], *data.qvel[:2]]
    np.testing.assert_allclose(after(engine, [0.2, 0.01, 0.5, 0.1], [0.0, 0.03]), expected, atol=1e-6)
    grip = engine.schema.command[1]
    assert (grip.kind, grip.body) == ("position", "")
    assert "kp grip" in [p.name for p in engine.parameters]
    assert [t.where for t in engine.terms if t.effect == "payload"] == ["wrist"]


def test_actuators_with_a_state_of_their_own(tmp_path: Path) -> None:
    """The state of a filter is one that recordings lack; a delay is left to the search."""
    text = arm().replace(
        '<motor name="push" joint="reach"/>',
        '<general name="push" joint="reach" dyntype="filterexact" dynprm=".05"/>'
        '<intvelocity name="glide" joint="pan" kp="5" actrange="-1 1"/>',
    )
    engine = loaded(tmp_path, text.replace('name="pan" joint', 'name="pan" delay=".01" nsample="5" joint'))
    assert [f.name for f in engine.schema.state][6:] == ["act_push", "act_glide"]
    assert not any(f.observed for f in engine.schema.state[6:])
    assert engine.schema.command[3].kind == "velocity"
    assert any("the delay of the actuator pan, 0.01 s, is left out" in note for note in engine.notes)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.act[:], data.ctrl[:] = [0.4, 0.2], [0.1, 0.2, 1.0, -0.5]
    step_like(engine, model, data)
    expected = np.r_[data.qpos, data.qvel, data.act]
    got = after(engine, [0.0] * 6 + [0.4, 0.2], [0.1, 0.2, 1.0, -0.5])
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-9)


MESH = '<asset><mesh name="m" file="nowhere.stl"/></asset>'


def test_a_picture_that_is_missing_is_done_without(tmp_path: Path) -> None:
    seen = arm(inside='<geom type="mesh" mesh="m" contype="0" conaffinity="0" mass="0"/>')
    engine = loaded(tmp_path, seen.replace("<worldbody>", MESH + "<worldbody>"))
    assert engine.notes == ("the file nowhere.stl is missing; the model is used without it",)


@pytest.mark.parametrize("attributes", ["", 'contype="0" conaffinity="0"'])
def test_a_mesh_that_gives_a_mass_must_be_there(tmp_path: Path, attributes: str) -> None:
    weighed = arm(inside=f'<geom type="mesh" mesh="m" {attributes}/>')
    with pytest.raises(
        SimgapError, match=r"nowhere\.stl is missing, and the mass of the body hand is computed from it"
    ):
        loaded(tmp_path, weighed.replace("<worldbody>", MESH + "<worldbody>"))


def test_a_mesh_of_a_body_with_a_given_mass_is_done_without(tmp_path: Path) -> None:
    inertial = '<inertial pos=".1 0 0" mass=".2" diaginertia=".001 .001 .001"/>'
    given = arm(inside=f'<geom type="mesh" mesh="m"/>{inertial}')
    assert loaded(tmp_path, given.replace("<worldbody>", MESH + "<worldbody>")).notes


def test_a_texture_that_is_missing_is_done_without(tmp_path: Path) -> None:
    assets = '<asset><texture name="t" type="2d" file="no.png"/><material name="blue" texture="t"/></asset>'
    text = arm(inside='<geom type="sphere" size=".01" mass="0" material="blue"/>')
    assert loaded(tmp_path, text.replace("<worldbody>", assets + "<worldbody>")).notes


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco><worldbody>", "cannot read this as MJCF or URDF"),
        (arm(end="<tendon><fixed><joint joint='none' coef='1'/></fixed></tendon>"), "MuJoCo cannot compile the model"),
    ],
)
def test_what_is_no_model(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(SimgapError, match=message):
        loaded(tmp_path, text)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(SimgapError, match="there is no such file"):
        load(tmp_path / "none.xml", STEP)


def test_names_for_what_has_none(tmp_path: Path) -> None:
    text = arm().replace('name="pan" joint="pan"', 'joint="pan"').replace('joint name="reach"', "joint")
    engine = loaded(tmp_path, text.replace('<motor name="push" joint="reach"/>', ""))
    assert engine.schema.columns[1:4] == ("pan_pos", "lift_pos", "joint2_pos")
    assert "cmd_pan" in engine.schema.columns
