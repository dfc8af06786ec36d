"""Rows of the engine, against MuJoCo's own steps of models that say the same in their XML."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from arms import URDF, arm

from simgap.effects.augmented import Augmented
from simgap.simulators.mujoco import MujocoEngine, Servos, load
from simgap.simulators.mujoco.steps import cut, quick
from simgap.simulators.mujoco.steps import stepped as stepped_engine
from simgap.simulators.tables import Points, tabulate
from simgap.types import SimgapError

STEP = 0.02


def write(folder: Path, text: str, name: str = "arm.xml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.fixture
def engine(tmp_path: Path) -> MujocoEngine:
    return load(write(tmp_path, arm()), STEP)


def some(engine: MujocoEngine, n: int = 6, seed: int = 0):
    """States, commands in parts and efforts; the slide is far from its limits."""
    rng = np.random.default_rng(seed)
    state = rng.normal(0.0, 0.3, (n, 6)) * [1, 1, 0.1, 1, 1, 0.1]
    return state, rng.normal(0.0, 0.5, (n, engine.parts, 3)), rng.normal(0.0, 0.1, (n, 3))


def stepped(text: str, rows: tuple[np.ndarray, np.ndarray, np.ndarray], engine: MujocoEngine) -> np.ndarray:
    """MuJoCo's own steps of a model, as long as the engine's and by the same rule."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = engine.model.opt.timestep, engine.model.opt.integrator
    model.opt.tolerance = model.opt.ls_tolerance = 1e-12
    data = mujoco.MjData(model)
    after = []
    for x, u, f in zip(*rows, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = x[:3], x[3:], f
        for control in np.repeat(u, engine.steps // len(u), axis=0):
            data.ctrl[:] = control
            mujoco.mj_step(model, data)
        after.append(np.r_[data.qpos, data.qvel])
    return np.array(after)


def none(engine: MujocoEngine, n: int) -> np.ndarray:
    return np.zeros((n, len(engine.terms)))


def test_columns_and_units(engine: MujocoEngine) -> None:
    schema = engine.schema
    states = [f"{joint}_{what}" for what in ("pos", "vel") for joint in ("pan", "lift", "reach")]
    assert schema.columns == ("time_s", *states, "cmd_pan", "cmd_lift", "cmd_push")
    assert [f.unit for f in schema.state] == ["rad", "rad", "m", "rad/s", "rad/s", "m/s"]
    assert [(f.kind, f.unit, f.body, f.axis) for f in schema.command] == [
        ("position", "rad", "pan", "yaw"), ("position", "rad", "lift", "yaw"), ("force", "N", "reach", "x")
    ]  # fmt: skip
    assert [f.effort for f in schema.state] == ["", "", "", "N m", "N m", "N"]


def test_rows_are_mujoco_s(engine: MujocoEngine) -> None:
    rows = some(engine)
    after = engine.rows(engine.nominal, none(engine, 6), *rows)
    np.testing.assert_allclose(after, stepped(arm(), rows, engine), atol=1e-10)


def test_states_that_recordings_lack_come_last(tmp_path: Path) -> None:
    """A velocity of one joint alone is recorded; efforts are in the order of the velocities."""
    path = write(tmp_path, arm())
    whole = load(path, STEP)
    columns = {"pan_pos", "lift_pos", "reach_pos", "lift_vel", "cmd_pan", "cmd_lift", "cmd_push"}
    part = load(path, STEP, columns)
    names = [f.name for f in part.schema.state]
    assert names[3:] == ["lift_vel", "pan_vel", "reach_vel"]
    assert [f.observed for f in part.schema.state] == [True] * 4 + [False] * 2
    state, command, effort = some(whole)
    order = [[f.name for f in whole.schema.state].index(name) for name in names]
    after = part.rows(part.nominal, none(part, 6), state[:, order], command, effort[:, [1, 0, 2]])
    np.testing.assert_array_equal(after, whole.rows(whole.nominal, none(whole, 6), state, command, effort)[:, order])


TERMS: dict[tuple[str, str], tuple[float, dict[str, str]]] = {
    ("coulomb_friction", "lift"): (0.3, {"lift": 'frictionloss=".3"'}),
    ("added_inertia", "pan"): (0.02, {"pan": 'armature=".02"'}),
    ("joint_spring", "pan"): (1.5, {"pan": 'stiffness="1.5"'}),
    ("payload", "hand"): (
        0.4,
        {"inside": '<body pos=".12 0 0"><inertial mass=".4" pos="0 0 0" diaginertia="0 0 0"/></body>'},
    ),
    ("force_limit", "pan"): (1 / 0.8, {"servo": 'forcerange="-.8 .8"'}),
}


@pytest.mark.parametrize("which", TERMS)
def test_a_term_is_the_attribute_in_xml(engine: MujocoEngine, which: tuple[str, str]) -> None:
    value, parts = TERMS[which]
    terms = none(engine, 6)
    at = [(t.effect, t.where) for t in engine.terms].index(which)
    rows = some(engine)
    unchanged = engine.rows(engine.nominal, terms, *rows)
    terms[::2, at] = value
    after = engine.rows(engine.nominal, terms, *rows)
    expected = stepped(arm(**parts), rows, engine)
    np.testing.assert_allclose(after[::2], expected[::2], rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(after[1::2], unchanged[1::2])
    assert np.abs(after[::2] - unchanged[::2]).max() > 1e-4


def test_gravity_compensation_of_all_bodies(engine: MujocoEngine) -> None:
    terms = none(engine, 6)
    at = [t.effect for t in engine.terms].index("joint_gravity")
    terms[:, at] = 0.5
    rows = some(engine)
    text = arm()
    for body in ("upper", "fore", "hand"):
        text = text.replace(f'<body name="{body}"', f'<body name="{body}" gravcomp=".5"')
    np.testing.assert_allclose(
        engine.rows(engine.nominal, terms, *rows), stepped(text, rows, engine), rtol=1e-8, atol=1e-9
    )


def test_viscous_drag_where_there_is_no_damping(tmp_path: Path) -> None:
    bare = arm().replace('damping=".2" armature', "armature").replace(' kv=".5"', "")
    engine = load(write(tmp_path, bare), STEP)
    terms = none(engine, 6)
    terms[:, [(t.effect, t.where) for t in engine.terms].index(("viscous_drag", "lift"))] = 0.7
    rows = some(engine)
    expected = stepped(bare.replace("armature", 'damping=".7" armature'), rows, engine)
    np.testing.assert_allclose(engine.rows(engine.nominal, terms, *rows), expected, rtol=1e-8, atol=1e-9)


def test_the_time_between_rows_is_a_term(engine: MujocoEngine) -> None:
    """It changes the rows where it is on, and no others."""
    rows, terms = some(engine), none(engine, 6)
    (at,) = [i for i, t in enumerate(engine.terms) if t.effect == "sampling_interval"]
    terms[::2, at] = 0.1 * STEP
    slower = stepped_engine(
        replace(engine, time_step=1.1 * STEP), engine.steps, engine.parts, int(engine.model.opt.integrator)
    )
    after = engine.rows(engine.nominal, terms, *rows)
    np.testing.assert_allclose(after[::2], slower.rows(engine.nominal, none(engine, 6), *rows)[::2], rtol=1e-9)
    np.testing.assert_array_equal(after[1::2], engine.rows(engine.nominal, none(engine, 6), *rows)[1::2])


def test_a_term_replaces_the_form_of_an_effect_that_it_names_and_no_other(engine: MujocoEngine) -> None:
    keys = [effect.key for effect in Augmented(engine).catalogue]
    assert keys.count("sampling_interval.constant") == keys.count("sampling_interval.stamped") == 1
    assert keys.count("payload") == 1
    assert "payload.own_motion" not in keys


def test_what_the_model_sets_is_a_parameter_and_no_term(engine: MujocoEngine) -> None:
    names = [p.name for p in engine.parameters]
    assert names == ["kp pan", "kp lift", "damping pan", "damping lift", "damping reach", "armature lift"]
    assert ("added_inertia", "lift") not in [(t.effect, t.where) for t in engine.terms]
    assert not [t for t in engine.terms if t.effect == "viscous_drag"]


def test_parameters_are_shares_of_the_model_s_values(engine: MujocoEngine) -> None:
    """The damping of a position servo and its joint's are one parameter."""
    phi = np.log([0.5, 1.0, 1.0, 2.0, 1.0, 3.0])
    text = arm().replace('kp="12"', 'kp="6"').replace('damping=".2" armature=".01"', 'damping=".4" armature=".03"')
    rows = some(engine)
    np.testing.assert_allclose(
        engine.rows(phi, none(engine, 6), *rows),
        stepped(text.replace('kv=".5"', 'kv="1"'), rows, engine),
        rtol=1e-8, atol=1e-9,
    )  # fmt: skip
    words = engine.words(phi)
    assert words[0] == "kp pan: 12 -> 6 N m/rad"
    assert words[3] == "damping lift: 0.7 -> 1.4 N m s/rad"


def test_terms_have_starts_within_physical_bounds(engine: MujocoEngine) -> None:
    for term in engine.terms:
        assert term.starts
        assert all(term.low < start < term.high and start != 0 for start in term.starts), term
        assert f"{{{term.constant}}}" in term.says
        assert set(term.outputs) <= {f.name for f in engine.schema.state}
        assert set(term.channels) <= {f.name for f in engine.schema.command}


def columns_of(engine: MujocoEngine) -> dict[str, Callable[[float], np.ndarray]]:
    """The next states of some rows as functions of one number each: state, command, parameter, effort and friction."""
    state, command, effort = some(engine, 4)
    at = [(t.effect, t.where) for t in engine.terms].index(("coulomb_friction", "lift"))
    friction = none(engine, 4)
    friction[:, at] = 0.1

    def row(phi=0.0, c=0.0, x=0.0, u=0.0, f=0.0) -> np.ndarray:
        each = np.eye(6)
        return engine.rows(
            phi * each[1], friction + c * np.eye(friction.shape[1])[at], state + x * each[4],
            command + u * np.eye(engine.parts)[0][:, None], effort + f * each[1, :3],
        )  # fmt: skip

    return {key: (lambda d, key=key: row(**{key: d})) for key in ("phi", "c", "x", "u", "f")}


@pytest.mark.parametrize("of", ["phi", "c", "x", "u", "f"])
def test_differences_of_two_sizes_agree(engine: MujocoEngine, of: str) -> None:
    row = columns_of(engine)[of]
    slopes = [(row(d) - row(-d)) / (2 * d) for d in (1e-4, 1e-5)]
    size = np.abs(slopes[0]).max()
    assert size > 0
    assert np.abs(slopes[0] - slopes[1]).max() < 1e-3 * size


def test_rows_do_not_depend_on_each_other_nor_on_what_was_asked_before(engine: MujocoEngine) -> None:
    rows = some(engine, 40)
    terms = none(engine, 40)
    terms[20:, 0] = 0.2
    once = engine.rows(engine.nominal, terms, *rows)
    engine.rows(engine.nominal + 0.3, terms + 0.05, *rows)
    order = np.random.default_rng(1).permutation(40)
    again = engine.rows(engine.nominal, terms[order], *(a[order] for a in rows))
    np.testing.assert_array_equal(once[order], again)


def test_two_threads_at_once(engine: MujocoEngine) -> None:
    rows = some(engine, 500)
    phis = [engine.nominal + share for share in np.linspace(-0.5, 0.5, 8)]
    one_by_one = [engine.rows(phi, none(engine, 500), *rows) for phi in phis]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda phi: engine.rows(phi, none(engine, 500), *rows), phis))
    np.testing.assert_array_equal(one_by_one, together)


def test_a_row_that_leaves_the_finite_numbers_spoils_no_other(
    engine: MujocoEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor does it leave a file in the current folder, as MuJoCo does by itself."""
    monkeypatch.chdir(tmp_path)
    before = set(tmp_path.iterdir())
    state, command, effort = some(engine)
    fine = engine.rows(engine.nominal, none(engine, 6), state, command, effort)
    state[2, 3], state[4, 1] = 1e12, np.nan
    after = engine.rows(engine.nominal, none(engine, 6), state, command, effort)
    assert np.isnan(after[[2, 4]]).all()
    np.testing.assert_array_equal(after[[0, 1, 3, 5]], fine[[0, 1, 3, 5]])
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("time_step", "steps", "parts"), [(0.02, 10, 5), (0.02006, 10, 5), (0.022, 12, 4), (1 / 15, 35, 5), (0.002, 1, 1)]
)
def test_a_row_is_cut_into_steps_no_longer_than_the_model_s(time_step: float, steps: int, parts: int) -> None:
    assert cut(time_step, 0.002) == (steps, parts)


@pytest.mark.parametrize("time_step", [0.02, 0.02006, 1 / 15, 0.002])
def test_rows_hardly_depend_on_how_long_steps_are(tmp_path: Path, time_step: float) -> None:
    engine = load(write(tmp_path, arm()), time_step)
    assert engine.steps % engine.parts == 0
    assert engine.model.opt.timestep * engine.steps == pytest.approx(time_step)
    finer = stepped_engine(engine, 20 * engine.steps, engine.parts, int(engine.model.opt.integrator))
    rows = some(engine)
    ends = [e.rows(e.nominal, none(e, 6), *rows) for e in (engine, finer)]
    np.testing.assert_allclose(*ends, rtol=2e-3, atol=2e-3)


def test_derivatives_are_taken_from_a_cheaper_engine_and_are_as_good(tmp_path: Path) -> None:
    """A stiff servo needs short steps to be followed to a millirad per second; its derivatives do not."""
    engine = load(write(tmp_path, arm().replace('kp="20" kv=".5"', 'kp="100" kv="1"')), STEP)
    assert engine.rough.steps < engine.steps
    assert engine.rough.rough is engine.rough
    state, command, _ = some(engine)
    at = Points(engine.nominal, none(engine, 6), state, command)
    cheap, dear = tabulate(engine, at), tabulate(replace(engine, rough_steps=engine.steps), at)
    for name in ("then", "by_state", "by_command", "by_phi", "by_effort", "by_term"):
        a, b = getattr(cheap, name), getattr(dear, name)
        np.testing.assert_allclose(a, b, atol=0.01 * np.abs(b).max(), err_msg=name)


def test_a_stiff_model_is_stable(tmp_path: Path) -> None:
    """Of fourth order it would need more steps than of an implicit rule of first."""
    engine = load(write(tmp_path, arm().replace('kp="20" kv=".5"', 'kp="2e5" kv="500"')), STEP)
    rows = some(engine)
    after = engine.rows(engine.nominal, none(engine, 6), *rows)
    assert engine.model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert np.abs(after[:, 1] - rows[1][:, -1, 1]).max() < 0.3
    assert np.isfinite(quick(engine).rows(engine.nominal, none(engine, 6), *rows)).all()


def test_a_urdf_with_servos(tmp_path: Path) -> None:
    path = write(tmp_path, URDF, "two.urdf")
    engine = load(path, STEP, servos=Servos(kp={"shoulder": 30.0, "elbow": 10.0}, kv=0.5, force_limit=5.0))
    assert [f.name for f in engine.schema.command] == ["cmd_shoulder", "cmd_elbow"]
    assert engine.words(engine.nominal)[0] == "kp shoulder: 30 -> 30 N m/rad"
    state = np.zeros((1, 4))
    for _ in range(400):
        state = engine.rows(
            engine.nominal, none(engine, 1), state, np.full((1, engine.parts, 2), 0.2), np.zeros((1, 2))
        )
    assert np.abs(state[0, :2] - 0.2).max() < 0.2
    assert np.abs(state[0, 2:]).max() < 1e-3
    with pytest.raises(SimgapError, match="no joint wrist without an actuator; there are: elbow, shoulder"):
        load(path, STEP, servos=Servos(kp={"wrist": 1.0}))


def test_a_urdf_without_servos_has_no_commands(tmp_path: Path) -> None:
    assert load(write(tmp_path, URDF, "two.urdf"), STEP).schema.command == ()
