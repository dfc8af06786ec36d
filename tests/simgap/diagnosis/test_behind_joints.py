"""Play and a spring between motor and link, against recordings of MuJoCo's own models that have them."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from servos import Servos, recorded

from simgap.diagnosis.inference import behind_joints as module
from simgap.diagnosis.inference.behind_joints import FOUND, _beside, _Contest, _without_companions
from simgap.diagnosis.inference.hidden import Gains, State, fitted
from simgap.diagnosis.inference.relinearise import itself
from simgap.diagnosis.likelihood.direct import driven, innovations
from simgap.diagnosis.likelihood.filter import gain_matrix
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, start, whitening
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.student_t import fit_noise, log_density
from simgap.diagnosis.likelihood.unmeasured import guessed
from simgap.effects.augmented import Augmented
from simgap.simulators.mujoco import load
from simgap.types import Recording, Sessions

ARM = """
<mujoco><compiler angle="radian" autolimits="true"/><option timestep="{step}" integrator="implicitfast"/>
  <worldbody><body><joint name="pan" axis="0 0 1" damping=".3" armature=".02"/>{deflection}
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".8" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><position name="pan" joint="pan" kp="25" kv="1"/></actuator></mujoco>
"""
DEFLECTION = '<joint name="deflection" axis="0 0 1" {}/>'
TRUE = {
    "play": DEFLECTION.format('range="-.015 .015" solreflimit=".002 1" damping=".002"'),
    "spring": DEFLECTION.format('stiffness="60" damping=".02"'),
}
STEP, ROWS, SESSIONS, NOISE = 0.02, 200, 3, 5e-4


def recordings(truth: str) -> list[Recording]:
    """Positions of the link, with noise; held and swept targets."""
    model = mujoco.MjModel.from_xml_string(ARM.format(step=5e-4, deflection=TRUE[truth]))
    data, sessions = mujoco.MjData(model), []
    for session in range(SESSIONS):
        rng = np.random.default_rng(session)
        command = np.repeat(rng.uniform(-0.6, 0.6, ROWS // 25), 25)
        command[ROWS // 2 :] = 0.4 * np.sin(np.arange(ROWS // 2) / (6 + session))
        mujoco.mj_resetData(model, data)
        data.qpos[0], position = command[0], []
        for u in command:
            position.append(data.qpos.sum())
            data.ctrl[:] = u
            mujoco.mj_step(model, data, round(STEP / model.opt.timestep))
        measured = np.array(position)[:, None] + NOISE * rng.normal(size=(ROWS, 1))
        sessions.append(Recording(str(session), np.arange(ROWS) * STEP, measured, command[:, None]))
    return sessions


def rivals(truth: str, folder: Path) -> tuple[float, list[State]]:
    """Log-likelihood of the model without anything more, and the rivals fitted."""
    path = folder / "arm.xml"
    path.write_text(ARM.format(step=0.002, deflection=""))
    engine = load(path, STEP, ["pan_pos", "cmd_pan"])
    sessions = guessed(engine, Sessions(recordings(truth), [], []))
    problem = Problem(Augmented(engine), None, cut(sessions.fitted, STEP), np.eye(1))  # type: ignore[arg-type]
    v = start(problem)
    gain = np.asarray(gain_matrix(problem.augmented, problem.scales, v), float)[:, :1]
    given = driven(problem, v)
    e = innovations(problem, engine, given, np.asarray(v.phi, float), gain, np.zeros(0))
    problem = problem._replace(whiten=whitening(e))
    e = e @ problem.whiten.T
    base = float(log_density(e, fit_noise(e)).sum())
    return base, fitted(problem, v, engine.split("pan"), Gains(base, base))


@pytest.mark.parametrize(("truth", "effect", "constant"), [("play", "link_backlash", 0.03),
                                                           ("spring", "elastic_joint", 1 / 60)])  # fmt: skip
def test_the_hidden_state_that_is_there_explains_most(truth: str, effect: str, constant: float, tmp_path: Path) -> None:
    base, states = rivals(truth, tmp_path)
    best, other = states
    assert best.engine.terms[-1].effect == effect
    assert best.loglik - base > 2 * (other.loglik - base)
    assert best.value == pytest.approx(constant, rel=0.15)
    assert best.at.phi == pytest.approx(0.0, abs=0.3)  # parameters make up for little


def test_innovations_by_numpy_are_those_of_the_filter() -> None:
    engine = Servos(velocities=False)
    sessions = guessed(engine, Sessions(recorded((0.3, 0.0, 0.0), velocities=False, sessions=2, rows=80), [], []))
    augmented = Augmented(engine)
    problem = Problem(augmented, measure(augmented, sessions.fitted), cut(sessions.fitted, 0.02), np.diag([2.0, 3.0]))
    v = start(problem)._replace(phi=np.array([0.1, 0.0, -0.2, 0.0], np.float32))
    gain = np.asarray(gain_matrix(augmented, problem.scales, v), float)[:, :2]
    found = innovations(problem, engine, driven(problem, v), np.asarray(v.phi, float), gain, np.zeros(0))
    np.testing.assert_allclose(found, evaluate(itself(problem), v, ()).e, atol=1e-3)


def test_rivals_share_what_the_effects_that_they_replace_do_not_keep() -> None:
    odds = _beside({"coulomb_friction": 0.9, "gain": 0.1}, {FOUND: 0.2, "link_backlash": 0.8})
    assert list(odds) == ["link_backlash", "coulomb_friction", "gain"]
    assert odds["coulomb_friction"] == pytest.approx(0.18)
    assert sum(odds.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(("needed", "expected"), [(200.0, ["friction"]), (3.0, ["friction", "payload"])])
def test_a_rival_also_replaces_what_is_not_needed_beside_it(
    needed: float, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    members = [SimpleNamespace(hypothesis=SimpleNamespace(name=n, groups=())) for n in ("friction", "payload")]
    found: Any = SimpleNamespace(
        members=members, problem=None, rounds=[SimpleNamespace(screening=SimpleNamespace(threshold=20.0))]
    )
    engine = SimpleNamespace(terms=[SimpleNamespace(effect="link_backlash")])
    play = State(engine, None, None, None, 900.0)  # type: ignore[arg-type]
    own = Fit(None, (), None, None, 500.0)  # type: ignore[arg-type]
    monkeypatch.setattr(module, "refitted", lambda *given: given[2]._replace(loglik=900.0 - needed))
    contest = _without_companions(found, _Contest(members[:1], own, own, None, [play]), lambda _: None)  # type: ignore[arg-type]
    assert [m.hypothesis.name for m in contest.replaced] == expected
