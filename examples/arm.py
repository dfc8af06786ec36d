"""An arm with three joints, `arm.xml`, and recordings of one that has physics which that model leaves out.

    python -m examples.record arm FOLDER [--missing friction] [--positions-only]

The real arm is the same model in steps of 1 ms, of fourth order, changed by one of `MISSING`. A command acts
from its row's time on and is held until the next one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from examples.sessions import ModelConfig, Session, write
from simgap.types import Field, Schema

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native, and unknown to type checkers.

MODEL = Path(__file__).with_name("arm.xml")
JOINTS = ("pan", "shoulder", "elbow")
FINE = 0.001
"""Time step of the real arm [s]."""
SETTLING = 2.0
"""Time for which the first command is held before a recording begins, so that the arm is at rest [s]."""


@dataclass(frozen=True)
class ArmConfig(ModelConfig):
    """How the arm is recorded."""

    missing: str = "friction"
    position_noise: float = 0.00035


@dataclass
class RealArm:
    """What may differ from the model: its attributes, the path of a command, and the clock. delay, lag: [s]. pace: time
    between rows as a share of what their time stamps say."""

    spec: Any
    delay: float = 0.0
    lag: float = 0.0
    pace: float = 1.0


def _friction(arm: RealArm, joints: tuple[str, ...]) -> None:
    for joint in joints:
        arm.spec.joint(joint).frictionloss = 0.3


def _payload(arm: RealArm) -> None:
    centre = arm.spec.site("tool").pos
    arm.spec.body("forearm").add_geom(size=[0.01, 0, 0], pos=centre, mass=0.4, contype=0, conaffinity=0)


def _gravity_compensation(arm: RealArm) -> None:
    for body in arm.spec.bodies[1:]:
        body.gravcomp = 0.5


def _kp(arm: RealArm) -> None:
    servo = arm.spec.actuator("shoulder")
    servo.gainprm[0], servo.biasprm[1] = 0.7 * servo.gainprm[0], 0.7 * servo.biasprm[1]


def _damping(arm: RealArm) -> None:
    arm.spec.joint("shoulder").damping = 1.6 * np.asarray(arm.spec.joint("shoulder").damping)


def _force_limit(arm: RealArm) -> None:
    servo = arm.spec.actuator("shoulder")
    servo.forcelimited, servo.forcerange = True, [-6.0, 6.0]


MISSING: dict[str, Callable[[RealArm], None]] = {
    "nothing": lambda arm: None,  # noqa: ARG005
    "friction": lambda arm: _friction(arm, ("shoulder",)),
    "friction_all": lambda arm: _friction(arm, JOINTS),
    "payload": _payload,
    "gravity_compensation": _gravity_compensation,
    "force_limit": _force_limit,
    "kp": _kp,
    "damping": _damping,
    "delay": lambda arm: setattr(arm, "delay", 0.03),
    "lag": lambda arm: setattr(arm, "lag", 0.05),
    "interval": lambda arm: setattr(arm, "pace", 0.95),
}
"""What the real arm has and the model has not. Those of kp and damping are no effects but wrong parameters."""


def schema(speeds: bool) -> Schema:
    """The columns of the recordings."""
    positions = [Field(f"{joint}_pos", "rad", "position", "body", joint, "yaw") for joint in JOINTS]
    velocities = [Field(f"{joint}_vel", "rad/s", "velocity", "body", joint, "yaw") for joint in JOINTS]
    commands = [Field(f"cmd_{joint}", "rad", "position", "body", joint, "yaw") for joint in JOINTS]
    return Schema((*positions, *velocities) if speeds else tuple(positions), tuple(commands))


def wishes(rng: np.random.Generator, rows: int, time_step: float) -> Float[np.ndarray, "T 3"]:
    """Joint angles to be commanded [rad]: for each joint three sines of 0.1 to 1.5 Hz, and steps held for 1 to 3 s."""
    time = np.arange(rows)[:, None, None] * time_step
    frequency = np.exp(rng.uniform(np.log(0.1), np.log(1.5), (3, 3)))
    size = 0.35 * rng.uniform(0.4, 1.0, (3, 3)) / np.maximum(1.0, frequency)
    waves = (size * np.sin(2 * np.pi * (frequency * time + rng.random((3, 3))))).sum(2)
    steps = np.empty((rows, 3))
    for joint in range(3):
        held: list[float] = []
        while len(held) < rows:
            held += [rng.uniform(-0.3, 0.3)] * round(rng.uniform(1.0, 3.0) / time_step)
        steps[:, joint] = held[:rows]
    return waves + steps


def arm_session(rng: np.random.Generator, rows: int, config: ArmConfig) -> Session:
    """States as measured and commands as sent, of the real arm."""
    arm = RealArm(mujoco.MjSpec.from_file(str(MODEL)))
    MISSING[config.missing](arm)
    arm.spec.option.timestep = FINE
    # A real arm moves without steps: by MuJoCo's own integrator of first order velocities would lead by half a step.
    arm.spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model = arm.spec.compile()
    data = mujoco.MjData(model)
    commands = wishes(rng, rows, config.time_step)
    substeps, late, settling = (round(t / FINE) for t in (arm.pace * config.time_step, arm.delay, SETTLING))
    sent = np.concatenate([np.repeat(commands[:1], settling + late, 0), np.repeat(commands, substeps, 0)])
    follow = 1.0 if arm.lag == 0 else 1 - np.exp(-FINE / arm.lag)
    data.qpos[:] = data.ctrl[:] = commands[0]
    states = np.empty((rows, 6))
    for step in range(settling + (rows - 1) * substeps + 1):
        row, rest = divmod(step - settling, substeps)
        if row >= 0 and rest == 0:
            states[row] = np.r_[data.qpos, data.qvel]
        data.ctrl[:] += follow * (sent[step] - data.ctrl)
        mujoco.mj_step(model, data)
    noise = rng.normal(0.0, np.repeat([config.position_noise, config.velocity_noise], 3), states.shape)
    return (states + noise)[:, : 6 if config.speeds else 3], commands


def record_arm(folder: Path, sessions: int, seconds: float, seed: int, config: ArmConfig) -> list[Path]:
    """Write a recording set of the arm, each session `seconds` [s] long; returns the files."""
    return write(
        folder, "arm", (sessions, seconds, seed), schema(config.speeds), config.time_step,
        lambda rng, rows: arm_session(rng, rows, config),
    )  # fmt: skip
