"""Arms are their models where nothing is concealed, and differ as the key says where something is."""

from collections import Counter
from pathlib import Path

import mujoco
import numpy as np
import pytest

from concealed import sessions
from concealed.arms import case, design
from concealed.arms.case import Recipe, conceal
from concealed.arms.causes import CAUSES
from concealed.arms.operator import commands
from concealed.arms.robot import BRISTLE, FINE, ROW, Arm, Gear, Session, Traits, plain
from concealed.arms.suite import recipes
from concealed.form import Array

ROWS = 120
MUJOCO = mujoco


def arm(joints: int) -> tuple[design.Design, Array]:
    """A design, and commands for it."""
    rng = np.random.default_rng(joints)
    return design.draw(joints, rng), commands(joints, ROWS, ROW * FINE, rng)


def run(of: design.Design, sent: Array, **traits: object) -> Session:
    """What an arm with these traits does."""
    return Arm(of, Traits(**{**plain(of).__dict__, **traits})).run(sent)


def of_model(of: design.Design, sent: Array, begun: Session) -> Array:
    """Angles by the user's MJCF in MuJoCo's own steps, from where a session begins."""
    model = MUJOCO.MjModel.from_xml_string(design.model(of))
    model.opt.timestep, model.opt.integrator = 0.00025, MUJOCO.mjtIntegrator.mjINT_RK4
    data = MUJOCO.MjData(model)
    data.qpos[:], data.qvel[:] = begun.angle[0], begun.speed[0]
    found = []
    for command in sent:
        found.append(data.qpos.copy())
        data.ctrl[:] = command
        for _ in range(round(ROW * FINE / model.opt.timestep)):
            MUJOCO.mj_step(model, data)
    return np.array(found)


@pytest.mark.parametrize("joints", design.JOINTS)
def test_without_a_cause_an_arm_is_its_model(joints: int) -> None:
    """To a tenth of the least noise, though nothing but the acceleration of the links is computed alike."""
    of, sent = arm(joints)
    found = run(of, sent)
    assert np.ptp(found.angle, axis=0).min() > 0.05
    assert np.abs(found.angle - of_model(of, sent, found)).max() < 0.05 * case.POSITION


def test_a_queue_and_a_filter_make_commands_late() -> None:
    of, sent = arm(3)
    as_is, late = run(of, sent), run(of, sent, late=2 * ROW * FINE)
    np.testing.assert_allclose(late.angle[2:], as_is.angle[:-2], atol=1e-9)
    step = np.where(np.arange(60)[:, None] < 5, sent[0], sent[0] + 0.3)
    slow, quick = (run(of, step, lag=lag).angle[:, 1] for lag in (0.06, 0.0))
    # A filter of first order takes its time constant, whatever follows it.
    assert (quick - slow)[5:].sum() * ROW * FINE / (quick[-1] - quick[0]) == pytest.approx(0.06, rel=0.02)


def test_a_dry_joint_sticks_and_slides() -> None:
    """Within its friction over the servo's stiffness it stays where it is; in motion it costs just its friction."""
    of, sent = arm(3)
    loss = 0.3
    still = np.repeat(sent[:1], 40, 0)
    still[10:, 0] += 0.5 * loss / of.stiffness[0]
    held = run(of, still, friction=np.array([loss, 0, 0]))
    assert np.ptp(held.angle[:, 0]) < 2 * BRISTLE
    ramp = np.repeat(sent[:1], 100, 0)
    ramp[:, 0] += 0.4 * ROW * FINE * np.arange(100)
    dry, free = (run(of, ramp, friction=np.array([f, 0, 0])) for f in (loss, 0.0))
    assert dry.torque[-1, 0] - free.torque[-1, 0] == pytest.approx(loss, rel=0.02)


def test_weights_bear_on_the_arm() -> None:
    """At rest the servos hold what the model's gravity asks for: less by what is carried, more by a load."""
    of, sent = arm(6)
    still = np.repeat(sent[:1], 2, 0)
    as_is, lifted, loaded = (run(of, still, **t) for t in ({}, {"lift": 1.0}, {"load": 0.4}))
    assert np.abs(as_is.torque[0]).max() > 1.0
    assert np.abs(lifted.torque[0]).max() < 0.01
    own = MUJOCO.MjModel.from_xml_string(design.model(of))
    data = MUJOCO.MjData(own)
    data.qpos[:] = loaded.angle[0]
    MUJOCO.mj_forward(own, data)
    arms_reach = data.site("tool").xpos[:2] - data.xpos[own.body("shoulder").id][:2]
    moment = 0.4 * 9.81 * np.linalg.norm(arms_reach)
    assert abs(loaded.torque[0, 1] - data.qfrc_bias[1]) == pytest.approx(moment, rel=0.05)


def test_a_servo_gives_no_more_than_its_limit() -> None:
    of, sent = arm(3)
    limited = run(of, sent, limit=np.array([1.0, np.inf, np.inf]))
    assert np.abs(limited.torque[:, 0]).max() == 1.0


def test_a_row_of_another_length_holds_commands_longer() -> None:
    of, sent = arm(3)
    held = np.repeat(sent[:30], 2, 0)
    np.testing.assert_allclose(run(of, sent[:30], row=2 * ROW).angle, run(of, held).angle[::2], atol=1e-9)


def test_a_gear_without_play_is_nearly_none_and_with_play_turns_idly() -> None:
    of, sent = arm(3)
    rigid = Gear(0, 0.0, 4e3, 5.0, 0.6, False)
    as_is = run(of, sent)
    assert np.abs(run(of, sent, gear=rigid).angle - as_is.angle).max() < 0.02
    wave = np.repeat(sent[:1], 400, 0)
    wave[:, 0] += 0.1 * np.sin(2 * np.pi * np.arange(400) / 400)
    worn, tight = (run(of, wave, gear=rigid._replace(play=play)).angle[:, 0] for play in (0.04, 0.0))
    assert np.ptp(tight) - np.ptp(worn) == pytest.approx(0.04, rel=0.15)


def test_the_motors_encoder_sees_the_motor() -> None:
    """At rest a spring behind it does not show; at the link it does."""
    of, sent = arm(3)
    still = np.repeat(sent[:1], 2, 0)
    spring = Gear(1, 0.0, 200.0, 1.0, 0.0, True)
    as_is, motor, link = (run(of, still, **t).angle[0, 1] for t in ({}, {"gear": spring},
                                                                  {"gear": spring._replace(seen=False)}))  # fmt: skip
    assert abs(motor - as_is) < 0.005
    assert abs(link - as_is) > 0.01


@pytest.mark.long
@pytest.mark.parametrize("speeds", [True, False])
def test_nothing_but_what_is_measured_depends_on_the_cause(speeds: bool) -> None:
    null = conceal(Recipe(None, 3, speeds), 2, 100, 7)
    assert null.key["strength"] == 0.0
    for name, cause in CAUSES.items():
        made = conceal(Recipe(name, 3, speeds), 2, 100, 7)
        assert (made.model, made.columns) == (null.model, null.columns)
        np.testing.assert_array_equal(made.command, null.command)
        assert made.measured.shape == null.measured.shape == (2, 100, 6 if speeds else 3)
        assert made.key["strength"] > 0.5, name
        assert made.key["kind"] == cause.kind
        assert [e["accept"] for e in made.key["effects"]] == ([] if name == "wrong kp" else [list(cause.accept)])
        assert all(e["constants"] for e in made.key["effects"])
        if name == "wrong kp":
            joint, true = made.key["parameter"][0].removeprefix("kp "), made.key["parameter"][1]
            assert f'joint="{joint}" kp="{true:.5f}"' not in made.model


def test_files_tell_nothing(tmp_path: Path) -> None:
    """Every session is as long as any other, of one time, and so is the model's file."""
    for name in (None, "payload"):
        made = conceal(Recipe(name, 3, True), 2, 100, 7)
        sessions.write(tmp_path / str(name), made.measured, made.command, made.columns, made.model)
    files = [[(p.name, p.stat().st_size, p.stat().st_mtime) for p in sorted((tmp_path / str(name)).iterdir())]
             for name in (None, "payload")]  # fmt: skip
    assert files[0] == files[1]
    assert [name for name, *_ in files[0]] == ["a.csv", "b.csv", sessions.MODEL]
    assert {time for *_, time in files[0]} == {sessions.EPOCH}


def test_parts_are_stratified() -> None:
    """Each has every cause once, and as many arms and ways to record of one kind as of the other."""
    parts = recipes(20, 10, [], 10, np.random.default_rng(0))
    for part in parts:
        counts = Counter(r.cause for r in part)
        assert counts == {None: 2, **dict.fromkeys(CAUSES, 1)}
        assert Counter((r.joints, r.speeds) for r in part).most_common()[-1][1] >= 3
    for cause in (None, *CAUSES):
        mine = Counter((r.joints, r.speeds) for part in parts for r in part if r.cause == cause)
        assert min(mine.values()) >= 2
        assert len(mine) == 4
    assert recipes(1, 0, [], 3, np.random.default_rng(0)) == [[Recipe(None, 3, True)]]
