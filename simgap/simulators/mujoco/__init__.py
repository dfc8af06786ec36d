"""Robots given as a MuJoCo model, as the engine of a diagnosis. The only package that imports `mujoco`."""

from simgap.simulators.mujoco.build import load
from simgap.simulators.mujoco.engine import MujocoEngine
from simgap.simulators.mujoco.patch import Change, Patched, patch
from simgap.simulators.mujoco.reading import Servos
from simgap.simulators.mujoco.replay import Scan, replay, rescaled, rescaling, scan

__all__ = [
    "Change", "MujocoEngine", "Patched", "Scan", "Servos", "load", "patch", "replay", "rescaled", "rescaling", "scan",
]  # fmt: skip
