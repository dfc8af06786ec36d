"""Free joints: the engine moves them as MuJoCo does, in coordinates that recordings can have."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from simgap.engines import no_effort
from simgap.simulators.mujoco import MujocoEngine, load, patch, replay
from simgap.types import Recording

STEP = 0.02
CRAFT = """
<mujoco>
  <compiler angle="{angle}" autolimits="true"/>
  <option timestep="0.002"/>
  <default><joint damping="3" armature="1" range="-0.1 0.1"/></default>
  <worldbody>
    <body name="hull" pos="0.3 -0.2 1" euler="{euler}">
      <freejoint/>
      <inertial pos="0.01 0 0.02" mass="1.2" diaginertia="0.012 0.015 0.02"/>
      <site name="side" pos="0.17 0.17 0"/>
      <body name="arm" pos="0 0 -0.1">
        <joint name="swing" axis="0 1 0" damping="0.01" armature="0" range="-170 170"/>
        <inertial pos="0 0 -0.1" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="lift" site="side" gear="0 0 1 0 0 0.02"/>
    <motor name="swing" joint="swing"/>
  </actuator>
  {end}
</mujoco>
"""
PARTS = [f"hull_{part}" for part in ("x", "y", "z", "yaw", "pitch", "roll")]
BOTH = [f"{name}_{what}" for name in (*PARTS, "swing") for what in ("pos", "vel")]
COLUMNS = {*BOTH, "cmd_lift", "cmd_swing"}


def craft(euler: str = "0 0 0", angle: str = "radian", end: str = "") -> str:
    return CRAFT.format(euler=euler, angle=angle, end=end)


def engine_of(text: str, columns: set[str] | None = None) -> MujocoEngine:
    return load(mujoco.MjSpec.from_string(text), STEP, columns)


def rates_to_spin(angles: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """The body's angular velocity about its own axes, from rates of yaw, pitch and roll."""
    (_, pitch, roll), (by_yaw, by_pitch, by_roll) = angles, rates
    return np.array([
        by_roll - by_yaw * np.sin(pitch),
        by_pitch * np.cos(roll) + by_yaw * np.cos(pitch) * np.sin(roll),
        -by_pitch * np.sin(roll) + by_yaw * np.cos(pitch) * np.cos(roll),
    ])  # fmt: skip


ENGINE = engine_of(craft())
MOVING = arrays(np.float64, 14, elements=st.floats(-1, 1))


@settings(max_examples=30)
@given(MOVING, arrays(np.float64, 2, elements=st.floats(-2, 2)))
def test_a_free_joint_moves_as_in_mujoco(state: np.ndarray, command: np.ndarray) -> None:
    names = [f.name for f in ENGINE.schema.state]
    at, speed = (state[[names.index(f"{p}_{what}") for p in (*PARTS, "swing")]] for what in ("pos", "vel"))
    model = mujoco.MjModel.from_xml_string(craft())
    model.opt.timestep, model.opt.integrator = ENGINE.model.opt.timestep, ENGINE.model.opt.integrator
    data = mujoco.MjData(model)
    quaternion = Rotation.from_euler("ZYX", at[3:6]).as_quat()[[3, 0, 1, 2]]
    data.qpos[:] = [*at[:3], *quaternion, at[6]]
    data.qvel[:] = [*speed[:3], *rates_to_spin(at[3:6], speed[3:6]), speed[6]]
    data.ctrl[:] = command
    mujoco.mj_step(model, data, nstep=ENGINE.steps)
    sent = np.tile(command, (1, ENGINE.parts, 1))
    after = ENGINE.rows(np.zeros(1), np.zeros((1, len(ENGINE.terms))), state[None], sent, no_effort(ENGINE, 1))[0]
    place, then = (after[[names.index(f"{p}_{what}") for p in (*PARTS, "swing")]] for what in ("pos", "vel"))
    np.testing.assert_allclose([*place[:3], place[6]], [*data.qpos[:3], data.qpos[7]], atol=1e-7)
    turned = Rotation.from_euler("ZYX", place[3:6]).inv() * Rotation.from_quat(data.qpos[[4, 5, 6, 3]])
    assert turned.magnitude() < 1e-5
    np.testing.assert_allclose([*then[:3], then[6]], [*data.qvel[:3], data.qvel[6]], atol=1e-4)
    np.testing.assert_allclose(rates_to_spin(place[3:6], then[3:6]), data.qvel[3:6], atol=1e-4)


def test_an_unnamed_free_joint_has_the_name_of_its_body_and_no_defaults_of_joints() -> None:
    assert {f.name for f in (*ENGINE.schema.state, *ENGINE.schema.command)} == COLUMNS
    assert [p.name for p in ENGINE.parameters] == ["damping swing"]
    kinds = {f.name: f.kind for f in ENGINE.schema.state}
    assert [kinds[f"{p}_pos"] for p in PARTS] == ["position"] * 3 + ["angle"] * 3
    assert kinds["swing_pos"] == "position"


@pytest.mark.parametrize(("angle", "euler"), [("radian", "0 0 0.7"), ("degree", "0 0 40.10704565915762")])
def test_a_body_that_is_turned_in_the_model_has_the_same_coordinates(angle: str, euler: str) -> None:
    engine = engine_of(craft(euler, angle))
    np.testing.assert_allclose(engine.machine.reference, [0.3, -0.2, 1, 0.7, 0, 0, 0], atol=1e-9)
    state = np.linspace(-0.5, 0.6, 14)[None]
    sent, terms = np.ones((1, engine.parts, 2)), np.zeros((1, len(engine.terms)))
    both = [e.rows(np.zeros(1), terms, state, sent, no_effort(e, 1)) for e in (engine, ENGINE)]
    np.testing.assert_allclose(*both, atol=1e-8)


def test_a_keyframe_gives_the_pose_in_which_the_rest_is_held() -> None:
    quaternion = " ".join(map(str, Rotation.from_euler("ZYX", [0.4, 0.3, -0.2]).as_quat()[[3, 0, 1, 2]]))
    end = f'<keyframe><key qpos="1 2 3 {quaternion} 0.5" ctrl="4 5"/></keyframe>'
    engine = engine_of(craft(end=end), {"hull_x_pos", "hull_yaw_pos", "cmd_swing"})
    np.testing.assert_allclose(engine.machine.reference, [1, 2, 3, 0.4, 0.3, -0.2, 0.5], atol=1e-9)
    np.testing.assert_array_equal(engine.machine.controls, [4, 5])
    assert [j.name for j in engine.machine.joints] == ["hull_x", "hull_yaw"]
    assert sum("held still" in note for note in engine.notes) == 5


def test_a_body_that_is_tilted_in_the_model_is_held_and_named() -> None:
    engine = engine_of(craft("0 0.3 0"))
    assert [j.name for j in engine.machine.joints] == ["swing"]
    assert "its body is tilted in the model's own pose" in engine.notes[0]


def test_findings_are_written_into_the_model_with_its_free_joint() -> None:
    terms = np.zeros(len(ENGINE.terms))
    at = {(t.effect, t.where): i for i, t in enumerate(ENGINE.terms)}
    terms[at["payload", "arm"]], terms[at["viscous_drag", "hull_x"]] = 0.25, 0.1
    assert {where for effect, where in at if effect == "coulomb_friction"} == {"swing"}
    assert "joint_gravity" not in {effect for effect, _ in at}
    patched = patch(ENGINE, np.array([np.log(2)]), terms, Path())
    model = mujoco.MjModel.from_xml_string(patched.xml)
    assert model.nq == 8
    assert model.body_mass.sum() == pytest.approx(1.2 + 0.1 + 0.25)
    assert float(model.joint("swing").damping[0]) == pytest.approx(0.02)
    assert patched.unwritten == ("viscous_drag at hull_x: MJCF has no such number for a single axis of a free joint",)


def test_whole_turns_are_no_error_of_a_replay() -> None:
    state = np.zeros((3, 14))
    names = [f.name for f in ENGINE.schema.state]
    sent = np.zeros((3, 2))
    path = ENGINE.path(np.zeros(1), np.zeros(len(ENGINE.terms)), state[0], sent)
    turned = path.copy()
    turned[1:, names.index("hull_yaw_pos")] += 2 * np.pi
    errors = replay(ENGINE, [Recording("a", STEP * np.arange(3), turned, sent)])
    np.testing.assert_allclose(errors, 0, atol=1e-9)
