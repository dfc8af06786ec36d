"""MuJoCo's toolbox on recordings that its own engine made: what it can fit, it finds."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from concealed import sessions
from concealed.arms import design
from concealed.arms.operator import commands
from concealed.form import Array
from tasks.sealed.judge import invented_friction, moved
from tasks.sealed.sysid import identified

JOINTS, ROWS, STEPS, FRICTION, FLOOR = 3, 80, 10, 0.3, 1e-4
NONE: dict[str, Any] = {"effects": [], "parameter": None, "floor": FLOOR}
DRY = {**NONE, "effects": [{"accept": ["coulomb_friction"], "channels": ["cmd_shoulder"]}]}


def recorded(model: mujoco.MjModel, command: Array) -> Array:
    """Positions of the joints, from rest, with next to no noise."""
    data, positions = mujoco.MjData(model), np.empty((len(command), JOINTS))
    data.ctrl[:] = command[0]
    mujoco.mj_step(model, data, 1500)
    for row, sent in enumerate(command):
        positions[row], data.ctrl[:] = data.qpos, sent
        mujoco.mj_step(model, data, STEPS)
    return positions


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three sessions of an arm with friction at its shoulder, which its model lacks."""
    rng = np.random.default_rng(0)
    text = design.model(design.draw(JOINTS, rng))
    spec = mujoco.MjSpec.from_string(text)
    spec.joint("shoulder").frictionloss = FRICTION
    sent = np.stack([commands(JOINTS, ROWS, STEPS * 0.002, rng) for _ in range(3)])
    measured = np.stack([recorded(spec.compile(), command) for command in sent])
    names = design.NAMES[:JOINTS]
    columns = sessions.Columns(tuple(f"{j}_pos" for j in names), tuple(f"cmd_{j}" for j in names), STEPS * 0.002)
    folder = tmp_path_factory.mktemp("sysid") / "case"
    sessions.write(folder, measured, sent, columns, text)
    return folder


def test_friction_is_found_and_the_replay_on_held_out_sessions_is_right(folder: Path) -> None:
    row = identified(folder / sessions.MODEL, folder, ["c"], DRY)
    assert row["sysid_friction"] == 0
    assert row["sysid_open_loop"] < 3
    assert identified(folder / sessions.MODEL, folder, ["c"], NONE)["sysid_friction"] == 1


def test_a_parameter_that_is_wrong_in_the_model_may_move() -> None:
    nominal, fitted = {"kp a": 10.0, "kp b": 10.0, "armature a": 0.0}, {"kp a": 12.0, "kp b": 10.5, "armature a": 1.0}
    assert moved(nominal, fitted, NONE) == 1
    assert moved(nominal, fitted, {**NONE, "parameter": ("kp a", 12.0)}) == 0


def test_friction_is_invented_where_the_robot_has_none() -> None:
    everywhere = {**DRY, "effects": [{"accept": ["coulomb_friction"], "channels": []}]}
    said = ["shoulder", "elbow", "elbow"]
    assert [invented_friction(said, key) for key in (DRY, everywhere, NONE)] == [1, 0, 2]
