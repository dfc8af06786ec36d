"""From a model file and the columns of recordings to an engine."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native, and unknown to type checkers.
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
"""Of the solver of constraints: friction must be differentiable by differences."""
ITERATIONS = 200
"""Most iterations of the solver and of its line search."""


def load(
    model: str | Path | mujoco.MjSpec,
    time_step: float,
    columns: Collection[str] | None = None,
    servos: Servos = NO_SERVOS,
) -> MujocoEngine:
    """A model to diagnose recordings with.

    model: path of an MJCF or URDF, or a model that MuJoCo has read. time_step: nominal interval between the recordings'
    rows [s]. columns: those that the recordings have, `<joint>_pos`, `<joint>_vel` and `cmd_<actuator>`; without them,
    all that the model could have. servos: for joints that have no actuator.

    Where nobody takes MuJoCo's own warnings, such as of an unstable row, they go to the log `mujoco` of Python's.

    Raises:
        SimgapError: the model cannot be read or compiled, or none of its joints is recorded.
    """
    if mujoco.get_mju_user_warning() is None:  # else MuJoCo writes a file into the current folder
        mujoco.set_mju_user_warning(logging.getLogger("mujoco").debug)
    source = read(model, servos)
    plain = compiled(source.spec)
    what = machine(plain, columns)
    ready = _ready(source.spec, payloads.places(plain, what))
    scaled, switched = parameters(ready, what), switches(ready, what)
    engine = MujocoEngine(source, ready, what, time_step, 1, 1, scaled, switched, np.zeros(len(scaled)))
    return accurate(engine)


def _ready(source: mujoco.MjSpec, carriers: dict[str, tuple[float, float, float]]) -> mujoco.MjModel:
    """A compiled model in which every term can be switched on, and whose next state depends on nothing hidden."""
    spec = source.copy()
    for carrier, centre in carriers.items():
        payloads.add(spec, payloads.PREFIX + carrier, carrier, centre, 0.0)
    carried = [body.gravcomp for body in spec.bodies]
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0  # MuJoCo leaves the whole computation out where no body has any
    for actuator in spec.actuators:
        actuator.delay, actuator.nsample = 0.0, 0  # a delay acts on commands, outside the engine
    model = compiled(spec)
    model.body_gravcomp[:] = carried
    option = model.opt
    option.solver, option.tolerance, option.ls_tolerance = mujoco.mjtSolver.mjSOL_NEWTON, TOLERANCE, TOLERANCE
    option.iterations = option.ls_iterations = ITERATIONS
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    return model
