"""Open-loop replays, and the scan that finds a model whose servos are far too stiff."""

import re
from pathlib import Path

import numpy as np
import pytest
from arms import arm

from simgap.simulators.mujoco import MujocoEngine, load, replay, rescaled, rescaling, scan
from simgap.types import Recording

STEP = 0.02
NOISE = 0.0005
STIFF = arm().replace('<motor name="push" joint="reach"/>', '<position name="push" joint="reach" kp="200"/>')


def engine(folder: Path, text: str = STIFF, columns: set[str] | None = None) -> MujocoEngine:
    (folder / "arm.xml").write_text(text)
    return load(folder / "arm.xml", STEP, columns)


def recordings(real: MujocoEngine, phi: np.ndarray, rows: int = 200) -> list[Recording]:
    """Two sessions of another engine, from rest, with noise."""
    rng = np.random.default_rng(0)
    found = []
    for name in ("a", "b"):
        command = np.repeat(rng.normal(0.0, [0.3, 0.3, 0.03], (rows // 20, 3)), 20, axis=0)
        start = np.r_[rng.normal(0.0, [0.2, 0.2, 0.02]), np.zeros(len(real.schema.state) - 3)]
        states = real.path(phi, np.zeros(len(real.terms)), start, command)
        states += rng.normal(0.0, NOISE, states.shape)
        found.append(Recording(name, np.arange(rows) * STEP, states, command))
    return found


def test_a_path_is_rows_one_after_the_other(tmp_path: Path) -> None:
    real = engine(tmp_path)
    rng = np.random.default_rng(0)
    command, state = rng.normal(0.0, 0.2, (10, 3)), np.r_[0.1, -0.2, 0.01, np.zeros(3)]
    path = real.path(real.nominal, np.zeros(len(real.terms)), state, command)
    for row in range(9):
        np.testing.assert_allclose(path[row], state, rtol=1e-9)
        held = np.tile(command[row], (1, real.parts, 1))
        state = real.rows(real.nominal, np.zeros((1, len(real.terms))), state[None], held, np.zeros((1, 3)))[0]
    np.testing.assert_allclose(path[9], state, rtol=1e-9)


def test_the_error_of_the_true_model_is_the_noise(tmp_path: Path) -> None:
    real = engine(tmp_path)
    phi = real.nominal + np.log(0.8)
    logs = recordings(real, phi)
    assert (replay(real, logs, phi) < 3 * NOISE).all()
    assert (replay(real, logs) > 3 * NOISE).all()


def test_positions_alone_begin_at_rest(tmp_path: Path) -> None:
    real = engine(tmp_path)
    logs = [log._replace(state=log.state[:, :3]) for log in recordings(real, real.nominal)]
    joints = ("pan", "lift", "reach")
    names = {f"{j}_pos" for j in joints} | {f"cmd_{a}" for a in ("pan", "lift", "push")}
    assert (replay(engine(tmp_path, columns=names), logs) < 3 * NOISE).all()


@pytest.mark.parametrize(("share", "says"), [(1 / 40, "times too stiff"), (12.0, "times too soft")])
def test_a_scan_finds_servos_that_are_wrong_by_far(tmp_path: Path, share: float, says: str) -> None:
    model = engine(tmp_path)
    servos = np.array([p.name.startswith("kp") for p in model.parameters])
    logs = recordings(model, np.log(share) * servos)
    found = scan(model, logs)
    assert found is not None
    assert found.far
    assert says in found.says
    assert abs(np.log(found.best / share)) < np.log(1.15)
    assert found.errors.shape == (len(found.shares), 3)
    nearer = rescaled(model, found.start)
    assert (replay(nearer, logs) < 0.3 * replay(model, logs)).any()
    ranges = [p for p in nearer.parameters if p.name.startswith("kp")]
    assert all(p.low < np.log(share) < p.high and p.nominal == np.log(found.best) for p in ranges)


def test_servos_that_are_wrong_by_different_factors_start_each_from_its_own(tmp_path: Path) -> None:
    """The lift's damping is wrong as well: with it as it is, no stiffness replays the joint."""
    real = engine(tmp_path)
    logs = recordings(real, real.nominal)
    stiffer = {'kp="12"': 'kp="720"', 'kp="20" kv=".5"': 'kp="300" kv="4"', 'kp="200"': 'kp="5000"'}
    text = STIFF
    for right, wrong in stiffer.items():
        text = text.replace(right, wrong)
    model = engine(tmp_path, text)
    true = {s.name: r.of / s.of for s, r in zip(model.scaled, real.scaled, strict=True)}
    names = [name for name, share in true.items() if share < 1]
    assert names == ["kp pan", "kp lift", "kp push", "damping lift"]
    found = scan(model, logs)
    assert found is not None
    assert found.far
    for name in names:
        assert abs(np.log2(found.start[name] / true[name])) < np.log2(3), name  # within the range of a parameter
    assert re.match(r"The model's position servos are \d+ to \d+ times too stiff \(kp\)\.$", found.says)
    nearer = rescaled(model, found.start)
    same = rescaled(model, {s.name: found.best for s in model.scaled if s.name.startswith("kp ")})
    motion = np.concatenate([log.state[:, :3] for log in logs]).std(0)
    of_each, of_all = (((replay(e, logs) / motion) ** 2).mean() for e in (nearer, same))
    assert of_each < 0.5 * of_all
    assert rescaling(nearer).startswith(f"{found.says} The diagnosis starts from kp pan ")
    assert rescaling(model) == ""


@pytest.mark.parametrize("share", [1.0, 0.6, 2.0])
def test_a_scan_leaves_alone_what_a_parameter_can_mend(tmp_path: Path, share: float) -> None:
    model = engine(tmp_path)
    servos = np.array([p.name.startswith("kp") for p in model.parameters])
    found = scan(model, recordings(model, np.log(share) * servos))
    assert found is not None
    assert not found.far
    assert found.says == ""


def test_no_scan_without_position_servos(tmp_path: Path) -> None:
    text = arm().replace("<position", "<motor").replace(' kp="12"', "").replace(' kp="20" kv=".5"', "")
    model = engine(tmp_path, text)
    assert scan(model, []) is None


def test_an_engine_that_leaves_the_finite_numbers_has_an_infinite_error(tmp_path: Path) -> None:
    model = engine(tmp_path)
    logs = recordings(model, model.nominal)
    assert np.isinf(replay(model, logs, model.nominal + 50.0)).all()
