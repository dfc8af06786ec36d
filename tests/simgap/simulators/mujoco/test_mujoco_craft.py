"""A craft on a free joint, without any parameter: what it lacks is named, along the axes of its free joint."""

from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest

import simgap

STEP, SESSIONS, ROWS = 0.05, 3, 80
CRAFT = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body name="hull">
      <freejoint/>
      <inertial pos="0 0 0" mass="4" diaginertia="0.1 0.1 0.2"/>
      <site name="left" pos="-0.3 0.2 0"/>
      <site name="right" pos="-0.3 -0.2 0"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="left" site="left" gear="1 0 0 0 0 0"/>
    <motor name="right" site="right" gear="1 0 0 0 0 0"/>
  </actuator>
</mujoco>
"""
COLUMNS = ("time_s", "hull_x_pos", "hull_y_pos", "hull_yaw_pos", "hull_x_vel", "hull_y_vel", "hull_yaw_vel",
           "cmd_left", "cmd_right")  # fmt: skip
DRAG, NOISE = 1.5, np.array([1e-3, 1e-3, 1e-3, 3e-3, 3e-3, 3e-3])


def session(seed: int) -> pd.DataFrame:
    """A session afloat, in MuJoCo's own state; water resists along both axes of the world."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(CRAFT)
    model.opt.gravity[:], model.opt.integrator = 0, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    heading = rng.uniform(-3, 3)
    data.qpos[3:] = [np.cos(heading / 2), 0, 0, np.sin(heading / 2)]
    states, commands, sent = [], [], np.zeros(2)
    for _ in range(ROWS):
        w, _, _, z = data.qpos[3:]
        true = [*data.qpos[:2], 2 * np.arctan2(z, w), *data.qvel[:2], data.qvel[5]]
        sent = 0.85 * sent + rng.normal(0, 2.5, 2)
        states.append(true + NOISE * rng.normal(size=6))
        commands.append(sent)
        data.ctrl[:] = sent
        for _ in range(round(STEP / model.opt.timestep)):
            data.qfrc_applied[:2] = -DRAG * data.qvel[:2]
            mujoco.mj_step(model, data)
    state = np.array(states)
    state[:, 2] = (state[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return pd.DataFrame(np.column_stack([STEP * np.arange(ROWS), state, np.array(commands)]), columns=COLUMNS)


@pytest.mark.long
def test_drag_of_a_craft_is_named_along_its_axes(tmp_path: Path) -> None:
    path = tmp_path / "craft.xml"
    path.write_text(CRAFT)
    found = simgap.diagnose(path, {f"s{seed}": session(seed) for seed in range(SESSIONS)})
    (effect,) = found.effects
    assert effect.id == "viscous_drag"
    assert set(effect.outputs) == {f"hull_{axis}_{what}" for axis in ("x", "y") for what in ("pos", "vel")}
    assert effect.constants["coefficient"]["value"] == pytest.approx(DRAG, rel=0.05)
    notes = " ".join(found.statement["notes"])
    assert all(f"the joint hull_{part} has no column" in notes for part in ("z", "pitch", "roll"))
    assert [line.split(":")[0] for line in found.statement["patched"]["unwritten"]] == [
        "viscous_drag at hull_x", "viscous_drag at hull_y"
    ]  # fmt: skip
