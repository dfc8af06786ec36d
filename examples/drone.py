"""A drone on a free joint, `drone.xml`, and recordings of one that has physics which that model leaves out.

    python -m examples.record drone FOLDER [--missing payload] [--positions-only]

The real drone is the same model in steps of 1 ms, of fourth order, changed by one of `MISSING`. It flies from place to
place, by a controller that sees what is measured. Thrusts act from their row's time on and are held until the next.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from examples.sessions import ModelConfig, Session, write
from simgap.types import Field, Schema

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native, and unknown to type checkers.

MODEL = Path(__file__).with_name("drone.xml")
PARTS = {"x": "m", "y": "m", "z": "m", "yaw": "rad", "pitch": "rad", "roll": "rad"}
MOTORS = ("front_left", "front_right", "rear_right", "rear_left")
FINE = 0.001
"""Time step of the real drone [s]."""
MASS, INERTIA, ARM, SPIN = 1.2, np.array([0.012, 0.012, 0.02]), 0.17, 0.02
"""What the controller knows: mass [kg], moments of inertia [kg m^2], where the motors are along both axes [m], and the
torque of a propeller for its thrust [m]."""
GRAVITY = 9.81
MIXING = np.linalg.inv(
    [[1, 1, 1, 1], [ARM, -ARM, -ARM, ARM], [-ARM, -ARM, ARM, ARM], [SPIN, -SPIN, SPIN, -SPIN]]
)  # fmt: skip
"""Thrusts of the motors from the total thrust and the torques of roll, pitch and yaw."""


@dataclass(frozen=True)
class DroneConfig(ModelConfig):
    """How the drone is recorded."""

    missing: str = "payload"


@dataclass
class RealDrone:
    """What may differ from the model: its attributes, thrusts as shares of the commanded ones, their delay [s], and the
    air. wind: force along x [N]; drag: force for a speed [N s/m]."""

    spec: Any
    shares: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    delay: float = 0.0
    wind: float = 0.0
    drag: float = 0.0


def _payload(drone: RealDrone) -> None:
    load = drone.spec.body("frame").add_body(name="load", mass=0.15, explicitinertial=True)
    load.ipos, load.iquat = [0, 0, 0], [1, 0, 0, 0]


MISSING: dict[str, Callable[[RealDrone], None]] = {
    "nothing": lambda drone: None,  # noqa: ARG005
    "payload": _payload,
    "delay": lambda drone: setattr(drone, "delay", 0.02),
    "weak_motor": lambda drone: setattr(drone, "shares", (0.9, 1.0, 1.0, 1.0)),
    "wind": lambda drone: setattr(drone, "wind", 0.4),
    "drag": lambda drone: setattr(drone, "drag", 0.3),
}
"""What the real drone has and the model has not."""


def schema(speeds: bool) -> Schema:
    """The columns of the recordings."""
    positions = [Field(f"frame_{part}_pos", unit, "position", "world") for part, unit in PARTS.items()]
    velocities = [Field(f"frame_{part}_vel", f"{unit}/s", "velocity", "world") for part, unit in PARTS.items()]
    commands = [Field(f"cmd_{motor}", "N", "force", "body") for motor in MOTORS]
    return Schema((*positions, *velocities) if speeds else tuple(positions), tuple(commands))


def observed(data: Any) -> Float[np.ndarray, " 12"]:
    """Place, yaw, pitch and roll, and the rates of these, of MuJoCo's state of a free joint."""
    yaw, pitch, roll = Rotation.from_quat(data.qpos[[4, 5, 6, 3]]).as_euler("ZYX")
    about_x, about_y, about_z = data.qvel[3:]
    turning = (about_y * np.sin(roll) + about_z * np.cos(roll)) / np.cos(pitch)
    rates = turning, about_y * np.cos(roll) - about_z * np.sin(roll), about_x + turning * np.sin(pitch)
    return np.array([*data.qpos[:3], yaw, pitch, roll, *data.qvel[:3], *rates])


def thrusts(
    measured: Float[np.ndarray, " 12"], goal: Float[np.ndarray, " 4"], shaking: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " 4"]:
    """Thrusts [N] that fly towards a place and a yaw, with a pilot's unsteady hand: `shaking` [rad/s^2]."""
    place, (yaw, pitch, roll), speed, rates = np.split(measured, 4)
    wanted = 1.2 * np.clip(goal[:2] - place[:2], -1, 1) - 1.2 * speed[:2]
    ahead = np.cos(yaw) * wanted[0] + np.sin(yaw) * wanted[1]
    left = -np.sin(yaw) * wanted[0] + np.cos(yaw) * wanted[1]
    tilt = np.clip([-left, ahead], -4, 4) / GRAVITY
    off = (goal[3] - yaw + np.pi) % (2 * np.pi) - np.pi
    turn = np.array([60 * (tilt[0] - roll) - 12 * rates[2], 60 * (tilt[1] - pitch) - 12 * rates[1],
                     3 * np.clip(off, -1, 1) - 3 * rates[0]])  # fmt: skip
    rise = GRAVITY + 4 * np.clip(goal[2] - place[2], -1, 1) - 3 * speed[2]
    total = MASS * rise / max(0.6, np.cos(pitch) * np.cos(roll))
    return np.clip(MIXING @ [total, *(INERTIA * (turn + shaking))], 0, 8)


def drone_session(rng: np.random.Generator, rows: int, config: DroneConfig) -> Session:
    """States as measured and commands as sent, of the real drone."""
    drone = RealDrone(mujoco.MjSpec.from_file(str(MODEL)))
    MISSING[config.missing](drone)
    drone.spec.option.timestep, drone.spec.option.integrator = FINE, mujoco.mjtIntegrator.mjINT_RK4
    model = drone.spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:3] += rng.normal(0, 0.3, 3)
    substeps, late = round(config.time_step / FINE), round(drone.delay / FINE)
    noise = np.repeat([config.position_noise, config.velocity_noise], 6)
    states, commands = np.empty((rows, 12)), np.empty((rows, 4))
    goal = np.zeros(4)
    for row in range(rows):
        if row == 0 or rng.random() < config.time_step:  # on average once a second
            goal = np.array([*rng.normal(0, 1.5, 2), rng.normal(1.5, 0.5), rng.uniform(-3, 3)])
        states[row] = observed(data) + noise * rng.normal(size=12)
        states[row, 3] = np.pi - (np.pi - states[row, 3]) % (2 * np.pi)  # to (-pi, pi]
        commands[row] = thrusts(states[row], goal, rng.normal(0, (6, 6, 2)))
        for fine in range(row * substeps, (row + 1) * substeps):
            data.ctrl[:] = drone.shares * commands[max(fine - late, 0) // substeps]
            data.qfrc_applied[:3] = -drone.drag * data.qvel[:3]
            data.qfrc_applied[0] += drone.wind
            mujoco.mj_step(model, data)
    return states[:, : 12 if config.speeds else 6], commands


def record_drone(folder: Path, sessions: int, seconds: float, seed: int, config: DroneConfig) -> list[Path]:
    """Write a recording set of the drone, each session `seconds` [s] long; returns the files."""
    return write(
        folder, "drone", (sessions, seconds, seed), schema(config.speeds), config.time_step,
        lambda rng, rows: drone_session(rng, rows, config),
    )  # fmt: skip
