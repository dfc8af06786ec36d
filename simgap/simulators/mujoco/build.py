"""Builds an engine from a model file and the columns of recordings."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
import logging
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from simgap.simulators.mujoco import payloads
from simgap.simulators.mujoco.attributes import parameters
from simgap.simulators.mujoco.engine import MujocoEngine
from simgap.simulators.mujoco.floating import unfolded
from simgap.simulators.mujoco.machine import machine
from simgap.simulators.mujoco.reading import NO_SERVOS, Servos, compiled, read
from simgap.simulators.mujoco.ready import ready
from simgap.simulators.mujoco.steps import accurate
from simgap.simulators.mujoco.terms import switches


def load(
    model: str | Path | mujoco.MjSpec,
    time_step: float,
    columns: Collection[str] | None = None,
    servos: Servos = NO_SERVOS,
) -> MujocoEngine:
    """The engine of a model, to diagnose recordings with.

    model: path of an MJCF or URDF, or a model that MuJoCo has read. time_step: nominal interval between rows of the
    recordings [s]. columns: those of the recordings, `<joint>_pos`, `<joint>_vel` and `cmd_<actuator>`; None: all that
    the model could have. A free joint has those of six others (see `floating`). servos: for joints without an actuator.

    MuJoCo's own warnings, such as of an unstable row, go to Python's logger `mujoco`, unless they have a handler.

    Raises:
        SimgapError: the model cannot be read or compiled, or none of its joints is recorded.
    """
    if mujoco.get_mju_user_warning() is None:  # else MuJoCo writes a file into the current folder
        mujoco.set_mju_user_warning(logging.getLogger("mujoco").debug)
    as_read = read(model, servos)
    spec, floating = unfolded(as_read.spec, columns)
    source = replace(as_read, spec=spec, floating=floating)
    plain = compiled(source.spec)
    robot = machine(plain, columns, source.floating)
    prepared = ready(source.spec, payloads.places(plain, robot))
    scaled, switched = parameters(prepared, robot), switches(prepared, robot, time_step)
    engine = MujocoEngine(source, prepared, robot, time_step, 1, 1, 1, scaled, switched, np.zeros(len(scaled)))
    return accurate(engine)
