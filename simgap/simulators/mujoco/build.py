"""Builds an engine from a model file and the columns of recordings."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
import logging
from collections.abc import Collection
from pathlib import Path

import mujoco
import numpy as np

from simgap.simulators.mujoco import payloads
from simgap.simulators.mujoco.attributes import parameters
from simgap.simulators.mujoco.engine import MujocoEngine
from simgap.simulators.mujoco.machine import machine
from simgap.simulators.mujoco.reading import NO_SERVOS, Servos, compiled, read
from simgap.simulators.mujoco.steps import accurate
from simgap.simulators.mujoco.terms import switches

TOLERANCE = 1e-12
"""Tolerance of the constraint solver: friction must be differentiable by finite differences."""
ITERATIONS = 200
"""Maximum number of iterations of the solver and of its line search."""


def load(
    model: str | Path | mujoco.MjSpec,
    time_step: float,
    columns: Collection[str] | None = None,
    servos: Servos = NO_SERVOS,
) -> MujocoEngine:
    """The engine of a model, to diagnose recordings with.

    model: path of an MJCF or URDF, or a model that MuJoCo has read. time_step: nominal interval between rows of the
    recordings [s]. columns: those of the recordings, `<joint>_pos`, `<joint>_vel` and `cmd_<actuator>`; None: all that
    the model could have. servos: for joints that have no actuator.

    MuJoCo's own warnings, such as of an unstable row, go to Python's logger `mujoco`, unless they have a handler.

    Raises:
        SimgapError: the model cannot be read or compiled, or none of its joints is recorded.
    """
    if mujoco.get_mju_user_warning() is None:  # else MuJoCo writes a file into the current folder
        mujoco.set_mju_user_warning(logging.getLogger("mujoco").debug)
    source = read(model, servos)
    plain = compiled(source.spec)
    robot = machine(plain, columns)
    ready = _ready(source.spec, payloads.places(plain, robot))
    scaled, switched = parameters(ready, robot), switches(ready, robot, time_step)
    engine = MujocoEngine(source, ready, robot, time_step, 1, 1, 1, scaled, switched, np.zeros(len(scaled)))
    return accurate(engine)


def _ready(source: mujoco.MjSpec, carriers: dict[str, tuple[float, float, float]]) -> mujoco.MjModel:
    """A compiled model in which every term can be switched on, and whose next state depends on no hidden state."""
    spec = source.copy()
    for carrier, centre in carriers.items():
        payloads.add(spec, payloads.PREFIX + carrier, carrier, centre, 0.0)
    compensation = [body.gravcomp for body in spec.bodies]
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0  # MuJoCo skips the whole computation where no body has any
    for actuator in spec.actuators:
        actuator.delay, actuator.nsample = 0.0, 0  # a delay acts on commands, outside the engine
    model = compiled(spec)
    model.body_gravcomp[:] = compensation
    option = model.opt
    option.solver, option.tolerance, option.ls_tolerance = mujoco.mjtSolver.mjSOL_NEWTON, TOLERANCE, TOLERANCE
    option.iterations = option.ls_iterations = ITERATIONS
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    return model
