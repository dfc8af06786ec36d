"""The drone: recordings that are read back, and that differ from the model by what they are said to miss."""

from pathlib import Path

import numpy as np
import pytest

from examples.drone import MISSING, MODEL, MOTORS, DroneConfig, drone_session
from simgap.engines import no_effort
from simgap.simulators.mujoco import MujocoEngine, load

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def engine() -> MujocoEngine:
    return load(MODEL, DroneConfig.time_step)


def missed(engine: MujocoEngine, missing: str, **changed: float) -> float:
    """Largest error of a velocity [m/s, rad/s] of the model over single rows, of a session without noise.

    changed: terms by effect and place, `payload_frame=0.15`; the share of a motor's thrust; a wind [N]; or rows by
    which commands are late.
    """
    states, commands = drone_session(np.random.default_rng(3), 100, DroneConfig(missing, True, 0.02, 0.0, 0.0))
    late, wind = int(changed.pop("late", 0)), changed.pop("wind", 0.0)
    sent = commands * [changed.pop(motor, 1.0) for motor in MOTORS]
    sent = np.vstack([np.repeat(sent[:1], late, 0), sent])[: len(sent)]
    terms = [changed.pop(f"{t.effect}_{t.where}", 0.0) for t in engine.terms]
    assert not changed
    effort = no_effort(engine, 99)
    effort[:, 0] = wind
    after = engine.rows(
        engine.nominal, np.tile(terms, (99, 1)), states[:-1], np.repeat(sent[:-1, None], engine.parts, 1), effort
    )
    return float(np.abs(after - states[1:])[:, 6:].max())


CURES: dict[str, dict[str, float]] = {
    "nothing": {},
    "payload": {"payload_frame": 0.15},
    "delay": {"late": 1},
    "weak_motor": {"front_left": 0.9},
    "wind": {"wind": 0.4},
    "drag": {f"viscous_drag_frame_{axis}": 0.3 for axis in ("x", "y", "z")},
}


@pytest.mark.parametrize("missing", MISSING)
def test_what_is_missing_explains_the_recordings_and_nothing_else_does(engine: MujocoEngine, missing: str) -> None:
    assert missed(engine, missing, **CURES[missing]) < 1e-5
    if missing != "nothing":
        assert missed(engine, missing) > 1e-3
