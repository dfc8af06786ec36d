"""The arm: recordings that are read back, and that differ from the model by what they are said to miss."""

from pathlib import Path

import numpy as np
import pytest

from examples.arm import JOINTS, MISSING, MODEL, ArmConfig, arm_session
from simgap.simulators.mujoco import MujocoEngine, load

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def engine() -> MujocoEngine:
    return load(MODEL, ArmConfig.time_step)


def open_loop_error(engine: MujocoEngine, missing: str, phi: np.ndarray, **terms: float) -> np.ndarray:
    """Of the positions [rad], over a session of 200 rows; terms by effect and place, `payload_forearm=0.4`."""
    states, commands = arm_session(np.random.default_rng(3), 200, ArmConfig(missing))
    values = [terms.pop(f"{t.effect}_{t.where}", 0.0) for t in engine.terms]
    assert not terms
    predicted = engine.path(phi, np.array(values), states[0], commands)
    return np.sqrt(((predicted - states)[:, :3] ** 2).mean(0))


def test_nothing_missing_is_noise(engine: MujocoEngine) -> None:
    assert (open_loop_error(engine, "nothing", engine.nominal) < 4 * ArmConfig.position_noise).all()


@pytest.mark.parametrize("missing", [m for m in MISSING if m != "nothing"])
def test_what_is_missing_shows(engine: MujocoEngine, missing: str) -> None:
    assert open_loop_error(engine, missing, engine.nominal).max() > 8 * ArmConfig.position_noise


CURES = {
    "friction": {"coulomb_friction_shoulder": 0.3},
    "friction_all": {f"coulomb_friction_{joint}": 0.3 for joint in JOINTS},
    "payload": {"payload_forearm": 0.4},
    "gravity_compensation": {"joint_gravity_all": 0.5},
    "force_limit": {"force_limit_shoulder": 1 / 6},
    "interval": {"sampling_interval_all": -0.001},
}


@pytest.mark.parametrize("missing", CURES)
def test_the_engine_s_term_for_it_explains_it(engine: MujocoEngine, missing: str) -> None:
    assert (open_loop_error(engine, missing, engine.nominal, **CURES[missing]) < 4 * ArmConfig.position_noise).all()


@pytest.mark.parametrize(("missing", "share"), [("kp", 0.7), ("damping", 1.6)])
def test_a_wrong_parameter_is_a_parameter(engine: MujocoEngine, missing: str, share: float) -> None:
    phi = engine.nominal.copy()
    phi[[p.name for p in engine.parameters].index(f"{missing} shoulder")] = np.log(share)
    assert (open_loop_error(engine, missing, phi) < 4 * ArmConfig.position_noise).all()
