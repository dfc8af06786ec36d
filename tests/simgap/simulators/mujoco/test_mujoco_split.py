"""A joint split into motor and link: the same as a second joint in the MJCF, and what its states mean."""

from pathlib import Path

import mujoco
import numpy as np
from arms import arm

from simgap.engines import split_of
from simgap.simulators.mujoco import MujocoEngine, load

STEP = 0.02
SPRING = '<joint name="lift_deflection" axis="0 1 0" stiffness="{k}" damping="{d}"/>'


def engine(folder: Path, text: str) -> MujocoEngine:
    path = folder / "arm.xml"
    path.write_text(text)
    return load(path, STEP)


def rivals(of: MujocoEngine, joint: str) -> dict[tuple[str, str], MujocoEngine]:
    return {(e.terms[-1].effect, e.terms[-1].form): e for e in of.split(joint)}


def test_rivals_are_play_and_a_spring_each_with_the_encoder_at_both_ends(tmp_path: Path) -> None:
    plain = engine(tmp_path, arm())
    found = rivals(plain, "lift")
    assert set(found) == {(e, at) for e in ("link_backlash", "elastic_joint") for at in ("link", "motor")}
    for rival in found.values():
        assert rival.parameters == plain.parameters
        assert [(t.effect, t.where) for t in rival.terms[:-1]] == [(t.effect, t.where) for t in plain.terms]
        assert rival.schema.state[:-2] == plain.schema.state
        assert not any(f.observed for f in rival.schema.state[-2:])
        assert rival.terms[-1].where == "lift"


def test_a_spring_is_that_of_a_second_joint_in_the_model(tmp_path: Path) -> None:
    rival = rivals(engine(tmp_path, arm()), "lift")["elastic_joint", "link"]
    terms = np.zeros(len(rival.terms))
    terms[-1] = rival.terms[-1].starts[1]
    made = rival.compiled(np.zeros(len(rival.parameters)), terms)
    k, d = (float(a[made.joint("lift_deflection").id]) for a in (made.jnt_stiffness, made.dof_damping))
    assert np.isclose(k, 1 / terms[-1])
    text = arm().replace('armature=".01" />', 'armature=".01" />' + SPRING.format(k=k, d=d))
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = STEP / rival.steps, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    motor, deflection = np.array([0.1, 0.3, 0.0]), 0.05
    data.qpos[:] = [motor[0], motor[1], deflection, motor[2]]
    data.ctrl[:] = [0.3, -0.2, 0.0]
    for _ in range(rival.steps):
        mujoco.mj_step(model, data)
    state = np.array([0.1, 0.3 + deflection, 0.0, 0, 0, 0, deflection, 0])
    command = np.tile([0.3, -0.2, 0.0], (1, rival.parts, 1))
    after = rival.rows(np.zeros(len(rival.parameters)), terms[None], state[None], command, np.zeros((1, 3)))[0]
    q, v = data.qpos, data.qvel
    expected = [q[0], q[1] + q[2], q[3], v[0], v[1] + v[2], v[3], q[2], STEP * v[2]]
    np.testing.assert_allclose(after, expected, atol=1e-6)


def test_the_link_moves_within_its_play_and_the_encoder_says_where_it_is_read(tmp_path: Path) -> None:
    plain = engine(tmp_path, arm())
    half, command = 0.02, np.zeros((100, 3))
    command[:, 0] = 0.4 * np.sin(np.arange(100) / 6)
    paths = {}
    for at in ("link", "motor"):
        rival = rivals(plain, "pan")["link_backlash", at]
        terms = np.zeros(len(rival.terms))
        terms[-1] = 2 * half
        paths[at] = rival.path(np.zeros(len(rival.parameters)), terms, np.zeros(8), command)
    deflection = paths["link"][:, -2]
    assert half < np.abs(deflection).max() < 1.5 * half  # stops give a little
    np.testing.assert_allclose(paths["link"][:, 0] - deflection, paths["motor"][:, 0], atol=1e-9)


def test_a_joint_before_another_in_its_body_is_not_split(tmp_path: Path) -> None:
    text = arm(pan='/><joint name="tilt" axis="0 1 0"')
    plain = engine(tmp_path, text)
    assert plain.split("pan") == ()
    assert len(plain.split("tilt")) == 4


def test_only_engines_with_hidden_states_have_rivals() -> None:
    assert split_of(object(), "lift") == ()  # type: ignore[arg-type]
