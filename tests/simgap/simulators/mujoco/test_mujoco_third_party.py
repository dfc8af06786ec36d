"""Models of arms that ship in packages of others, where these are installed: they load, move, and are patched.

None is a dependency of the project. To run these tests: `pip install --no-deps gymnasium robosuite dm_control`.
"""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from arms import starts

from simgap.simulators.mujoco import load, patch
from simgap.simulators.mujoco.steps import stepped

ARMS = {
    "gymnasium/envs/mujoco/assets/pusher_v5.xml": ("r_shoulder_pan_joint", 7),
    "robosuite/models/assets/robots/panda/robot.xml": ("joint1", 7),
    "robosuite/models/assets/robots/ur5e/robot.xml": ("shoulder_pan_joint", 6),
    "robosuite/models/assets/robots/xarm7/robot.xml": ("joint1", 7),
    "dm_control/suite/manipulator.xml": ("arm_root", 5),
}
"""For each the name of its first joint and how many actuators it has."""


def found(name: str) -> Path:
    package = name.split("/")[0]
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        pytest.skip(f"{package} is not installed")
    return Path(spec.origin).parent / name.removeprefix(f"{package}/")


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_loads_moves_and_is_patched(name: str, tmp_path: Path) -> None:
    joint, actuators = ARMS[name]
    engine = load(found(name), 0.02)
    assert engine.schema.columns[1] == f"{joint}_pos"
    assert len(engine.schema.command) == actuators
    rng = np.random.default_rng(0)
    joints = len(engine.machine.joints)
    state = np.zeros((4, len(engine.schema.state)))
    state[:, :joints] = engine.machine.reference[[j.qpos for j in engine.machine.joints]]
    state[:, :joints] += 0.01 * rng.normal(size=(4, joints))
    rows = (state, 0.1 * rng.normal(size=(4, engine.parts, actuators)), np.zeros((4, joints)))
    phi, terms = engine.nominal + 0.1, starts(engine)
    expected = engine.rows(phi, np.tile(terms, (4, 1)), *rows)
    assert np.isfinite(expected).all()
    patched = patch(engine, phi, terms, tmp_path)
    assert not patched.unwritten
    (tmp_path / "robot.patched.xml").write_text(patched.xml)
    other = load(tmp_path / "robot.patched.xml", 0.02)
    other = stepped(other, engine.steps, engine.parts, int(engine.model.opt.integrator))
    got = other.rows(other.nominal, np.zeros((4, len(other.terms))), *rows)
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6)
