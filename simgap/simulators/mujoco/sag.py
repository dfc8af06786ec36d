"""How far position servos sag at rest: under what they hold, in the model and with the fitted stiffness."""

from __future__ import annotations

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from simgap.simulators.mujoco.engine import MujocoEngine
from simgap.types import Recording

POSES = 500
"""Recorded poses at which loads are computed."""
MOST = 0.95
"""Share of the poses with a smaller load than the one that is reported: single poses do not decide."""
VISIBLE = 1e-3
"""Difference of sags [rad, m] from which it is worth a sentence; encoders of hobby servos resolve 1.5 mrad."""


@dataclass(frozen=True)
class Sag:
    """A servo at rest. load: what it holds [N m, N]. nominal, fitted: how far it sags under it [rad, m], with the
    stiffness of the model and with the fitted one."""

    joint: str
    unit: str
    load: float
    nominal: float
    fitted: float


def sags(
    engine: MujocoEngine,
    phi: Float[np.ndarray, " p"],
    terms: Float[np.ndarray, " k"],
    recordings: Sequence[Recording],
) -> list[Sag]:
    """The sag of every position servo whose stiffness is a parameter, at recorded poses.

    Weights are those of the model with these terms. Lengths and masses are not fitted, so a load is as right as they.
    """
    load, found = _loads(engine, phi, terms, recordings), []
    nominal = {s.name: s.of for s in engine.scaled}
    scaled = {s.name: s.of * float(np.exp(value)) for s, value in zip(engine.scaled, phi, strict=True)}
    for actuator in engine.machine.actuators:
        own, fitted = (stiffness.get(f"kp {actuator.name}") for stiffness in (nominal, scaled))
        if actuator.joint is not None and own and fitted:
            joint, size = actuator.joint, float(load[engine.machine.joints.index(actuator.joint)])
            found.append(Sag(joint.name, joint.unit, size, size / own, size / fitted))
    return found


def _loads(
    engine: MujocoEngine,
    phi: Float[np.ndarray, " p"],
    terms: Float[np.ndarray, " k"],
    recordings: Sequence[Recording],
) -> Float[np.ndarray, " j"]:
    """Forces that hold the joints at rest [N m, N]: the `MOST` quantile of their sizes."""
    joints, model = engine.machine.joints, engine.compiled(phi, terms)
    data = mujoco.MjData(model)
    positions = np.concatenate([r.state[:, : len(joints)] for r in recordings])
    loads = []
    for pose in positions[:: max(len(positions) // POSES, 1)]:
        data.qpos[:], data.qvel[:] = engine.machine.reference, 0.0
        data.qpos[[j.qpos for j in joints]] = pose
        mujoco.mj_forward(model, data)
        loads.append((data.qfrc_bias - data.qfrc_passive)[[j.dof for j in joints]])
    return np.quantile(np.abs(loads), MOST, axis=0)


def words(found: Sequence[Sag]) -> str:
    """A sentence on the servos that sag visibly more, or less, than the model says; empty if there is none."""
    visible = sorted(
        (s for s in found if abs(s.fitted - s.nominal) > VISIBLE), key=lambda s: -abs(s.fitted - s.nominal)
    )
    if not visible:
        return ""
    each = [f"{s.joint} by {_size(s.fitted, s.unit)} ({_size(s.nominal, s.unit)} in the model)" for s in visible]
    others = [s.joint for s in found if s not in visible]
    elsewhere = f" The others ({', '.join(others)}) sag as in the model." if others else ""
    return f"At rest, servos sag under the weight that they hold: {', '.join(each)}.{elsewhere}"


def _size(value: float, unit: str) -> str:
    """Two significant digits, never as a power of ten."""
    return f"{float(f'{1000 * value:.2g}'):g} m{unit}"
