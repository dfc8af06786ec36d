"""Play and a spring between motor and link, against recordings of MuJoCo's own models that have them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import jax
import mujoco
import numpy as np
import pytest
from servos import Servos, recorded

from simgap.diagnosis.diagnose import Diagnosis, _model, _replayed
from simgap.diagnosis.inference.explanation import Explanation, Hidden
from simgap.diagnosis.inference.fitting.relinearise import itself
from simgap.diagnosis.inference.hidden import behind_joints as module
from simgap.diagnosis.inference.hidden.behind_joints import FOUND, _beside, _Contest, _without_companions
from simgap.diagnosis.inference.hidden.rivals import Gains, State, fitted
from simgap.diagnosis.likelihood.direct import driven, innovations
from simgap.diagnosis.likelihood.filter import gain_matrix
from simgap.diagnosis.likelihood.problem import Fit, Group, Problem, evaluate, start, whitening
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.student_t import fit_noise, log_density
from simgap.diagnosis.likelihood.unmeasured import guessed
from simgap.diagnosis.likelihood.variables import Variables
from simgap.diagnosis.report.hidden_states import hidden_effects, notes
from simgap.diagnosis.validation.forecast import Contestant
from simgap.effects.augmented import Augmented
from simgap.engines import Engine
from simgap.formats.arrays import save_arrays
from simgap.formats.diagnoses import _arrays, read_simulator
from simgap.result import Result
from simgap.simulators.mujoco import MujocoEngine, load, replay
from simgap.simulators.refitted import nominal
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


def recordings(truth: str, which: Sequence[int] = range(SESSIONS), noise: float = NOISE) -> list[Recording]:
    """Positions of the link, with noise; held and swept targets."""
    model = mujoco.MjModel.from_xml_string(ARM.format(step=5e-4, deflection=TRUE[truth]))
    data, sessions = mujoco.MjData(model), []
    for session in which:
        rng = np.random.default_rng(session)
        command = np.repeat(rng.uniform(-0.6, 0.6, ROWS // 25), 25)
        command[ROWS // 2 :] = 0.4 * np.sin(np.arange(ROWS // 2) / (6 + session))
        mujoco.mj_resetData(model, data)
        data.qpos[0], position = command[0], []
        for u in command:
            position.append(data.qpos.sum())
            data.ctrl[:] = u
            mujoco.mj_step(model, data, round(STEP / model.opt.timestep))
        measured = np.array(position)[:, None] + noise * rng.normal(size=(ROWS, 1))
        sessions.append(Recording(str(session), np.arange(ROWS) * STEP, measured, command[:, None]))
    return sessions


class Contest(NamedTuple):
    """An arm that has a hidden state which its model lacks, and rivals fitted to recordings of it. base: log-likelihood
    of the model without anything more; v: its variables."""

    problem: Problem
    v: Variables
    base: float
    states: list[State]

    @property
    def engine(self) -> MujocoEngine:
        return cast(MujocoEngine, self.problem.augmented.simulator)

    @property
    def found(self) -> Explanation:
        """The explanation of a diagnosis that names the best rival, with nothing else."""
        best = self.states[0]
        value, odds = 1 / best.value if best.term.reciprocal else best.value, {best.term.effect: 1.0}
        hidden = Hidden(best.term, value, (value, value), odds, 0.0, 0.0, True, (), best.at.phi, np.zeros(0))
        noise: Any = SimpleNamespace(scale=np.ones(1), dof=np.ones(1))
        fit = Fit(self.v, (), np.zeros((0, 1)), noise, self.base)
        rest: Any = None
        return Explanation(self.problem, fit, fit, fit, rest, (), [], rest, rest, rest, (), [], 0, hidden=(hidden,))


@pytest.fixture(scope="module", params=TRUE)
def contest(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Contest]:
    """What is true, and the contest."""
    path = tmp_path_factory.mktemp(request.param) / "arm.xml"
    path.write_text(ARM.format(step=0.002, deflection=""))
    engine = load(path, STEP, ["pan_pos", "cmd_pan"])
    sessions = guessed(engine, Sessions(recordings(request.param), [], []))
    augmented = Augmented(cast(Engine, engine))
    problem = Problem(augmented, measure(augmented, sessions.fitted), cut(sessions.fitted, STEP), np.eye(1))
    v = start(problem)
    gain = np.asarray(gain_matrix(problem.augmented, problem.scales, v), float)[:, :1]
    given = driven(problem, v)
    e = innovations(problem, engine, given, np.asarray(v.phi, float), gain, np.zeros(0))
    problem = problem._replace(whiten=whitening(e))
    e = e @ problem.whiten.T
    base = float(log_density(e, fit_noise(e)).sum())
    return request.param, Contest(problem, v, base, fitted(problem, v, engine.split("pan"), Gains(base, base)))


@pytest.mark.long
def test_the_hidden_state_that_is_there_explains_most(contest: tuple[str, Contest]) -> None:
    truth, (_, _, base, (best, other)) = contest
    effect, constant = {"play": ("link_backlash", 0.03), "spring": ("elastic_joint", 1 / 60)}[truth]
    assert best.engine.terms[-1].effect == effect
    assert best.loglik - base > 2 * (other.loglik - base)
    assert best.value == pytest.approx(constant, rel=0.15)
    assert best.at.phi == pytest.approx(0.0, abs=0.3)  # parameters make up for little


def unseen(truth: str) -> Recording:
    """A session that was not fitted, without noise."""
    return recordings(truth, range(SESSIONS, SESSIONS + 1), noise=0.0)[0]


def error(positions: Sequence[float], recording: Recording) -> float:
    """Root mean square, in open loop over the whole session [rad]."""
    return float(np.sqrt(np.mean((np.array(positions) - recording.state[:, 0]) ** 2)))


def without_it(contest: Contest, recording: Recording) -> float:
    """Open-loop error of the model as it is [rad]."""
    (found,) = replay(contest.engine, [recording])
    return float(found)


@pytest.mark.long
def test_the_corrected_simulator_has_it_as_states_that_are_zero_at_first(
    contest: tuple[str, Contest], tmp_path: Path
) -> None:
    """Also after it was saved."""
    truth, case = contest
    model, recording = _model(case.found), unseen(truth)
    save_arrays(tmp_path / "augmented.npz", _arrays(model))
    robot = read_simulator(tmp_path / "augmented.npz", cast(Engine, case.engine))
    hidden = [f.name for f in robot.schema.state[2:]]
    assert hidden == ["pan_deflection", "pan_deflection_per_row"]
    assert robot.schema.measured == case.engine.schema.measured
    assert robot.effects == (case.states[0].term.effect,)
    phi, step, state, path = nominal(robot), jax.jit(robot.step), np.zeros(4), []
    state[0] = recording.state[0, 0]
    for u in recording.command:
        path.append(float(state[0]))
        state = step(phi, state, u)
    assert error(path, recording) < 0.3 * without_it(case, recording)


@pytest.mark.long
def test_the_patched_model_is_nearer_to_the_robot(contest: tuple[str, Contest], tmp_path: Path) -> None:
    """Stepped by MuJoCo alone, as a person would."""
    truth, case = contest
    result, recording = Result(case.engine, Diagnosis({}, {}, _model(case.found), None)), unseen(truth)
    (effect,) = hidden_effects(case.found)
    statement = {"effects": [effect], "closest_matches": [], "patched": {"file": "arm.patched.xml"}}
    result = replace(result, found=result.found._replace(statement=statement))
    ((_, text),) = result._models(tmp_path).items()
    model, path = mujoco.MjModel.from_xml_string(text), []
    assert [model.joint(j).name for j in range(model.njnt)] == ["pan", "pan_deflection"]
    data = mujoco.MjData(model)
    data.qpos[0] = recording.state[0, 0]
    for u in recording.command:
        at_link = case.states[0].term.form == "link"
        path.append(data.qpos.sum() if at_link else data.qpos[0])
        data.ctrl[:] = u
        mujoco.mj_step(model, data, round(STEP / model.opt.timestep))
    assert error(path, recording) < 0.3 * without_it(case, recording)


@pytest.mark.long
def test_open_loop_errors_are_of_the_simulator_that_has_it(contest: tuple[str, Contest]) -> None:
    truth, case = contest
    models = dict.fromkeys(("nominal", "refitted", "augmented"), Contestant(case.v))
    heldout = guessed(case.engine, Sessions([unseen(truth)], [], [])).training
    replayed = _replayed(case.found, models, heldout)
    assert replayed is not None
    errors = replayed["positions"][0]["errors"]
    assert errors["nominal"] == errors["refitted"]
    assert errors["augmented"] < 0.3 * errors["nominal"]


@pytest.mark.long
def test_it_takes_the_place_of_what_stood_in_for_it_alone(contest: tuple[str, Contest]) -> None:
    _, case = contest
    own = case.problem.augmented
    friction, delay = (next(i for i, slot in enumerate(own.slots) if own.catalogue[slot.effect].id == id)
                       for id in ("coulomb_friction", "delay"))  # fmt: skip
    theta = np.zeros(len(own.slots), np.float32)
    theta[[friction, delay]] = 0.2, 1.0
    members: Any = tuple(SimpleNamespace(hypothesis=SimpleNamespace(name=name, groups=(Group((i,), 1.0),)))
                         for name, i in (("friction", friction), ("delay", delay)))  # fmt: skip
    hidden = case.found.hidden[0]._replace(replaces=("friction",))
    fit = case.found.fit._replace(
        v=case.v._replace(theta=theta), groups=(Group((friction,), 1.0), Group((delay,), 1.0))
    )
    model = _model(case.found._replace(fit=fit, members=members, hidden=(hidden,)))
    assert model.behind == ("pan", case.states[0].term.effect, case.states[0].term.form)
    assert (model.theta[friction], model.theta[delay]) == (0.0, 1.0)
    assert model.theta[-1] == pytest.approx(case.states[0].value)
    assert len(model.theta) == len(own.slots) + 1
    np.testing.assert_allclose(model.phi, case.states[0].at.phi, rtol=1e-6)
    gain = np.asarray(gain_matrix(own, case.problem.scales, case.v))
    np.testing.assert_allclose(model.gain, np.pad(gain, (0, 2)))


@pytest.mark.long
def test_notes_say_which_models_have_it(contest: tuple[str, Contest]) -> None:
    _, case = contest
    (first,) = case.found.hidden
    other = first._replace(term=replace(first.term, where="lift"))
    unnamed = other._replace(named=False)
    said, left_out = notes(case.found._replace(hidden=(unnamed, first._replace(replaces=("friction",)), other)))
    effect = first.term.effect.replace("_", " ")
    assert said.startswith(f"The corrected simulator has {effect} at pan as two more states")
    assert "the simulator with friction in its place" in said
    assert left_out.startswith(f"The corrected simulator lacks {effect} at lift")


@pytest.mark.long
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
