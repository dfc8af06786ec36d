"""Sag and lag of position servos: what their stiffness and damping mean for where they are."""

from __future__ import annotations

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from simgap.diagnosis.report.names import number
from simgap.simulators.mujoco.engine import MujocoEngine
from simgap.types import Recording

POSES = 500
"""Recorded poses at which loads are computed."""
MOST = 0.95
"""Share of the poses with a smaller load than the one that is reported: single poses do not decide."""
SAG_SHOWS = 1e-3
"""Difference of sags [rad, m] from which it is worth a sentence; encoders of hobby servos resolve 1.5 mrad."""
LAG_SHOWS = 0.5
"""The same for lags, in rows."""


@dataclass(frozen=True)
class ServoError:
    """How far a position servo is from its command, in the model and with the fitted parameters.

    load: what it holds at rest [N m, N]. nominal_sag, sag: how far it sags under that [rad, m]. nominal_lag, lag: how
    late it is behind a command that moves steadily [s], which is its damping over its stiffness.
    """

    joint: str
    unit: str
    load: float
    nominal_sag: float
    sag: float
    nominal_lag: float
    lag: float


def servo_errors(
    engine: MujocoEngine,
    phi: Float[np.ndarray, " p"],
    terms: Float[np.ndarray, " k"],
    recordings: Sequence[Recording],
) -> list[ServoError]:
    """Every position servo whose stiffness is a parameter, at recorded poses.

    Weights are those of the model with these terms. Lengths and masses are not fitted, so a load is as right as they.
    """
    load, found = _loads(engine, phi, terms, recordings), []
    nominal = {s.name: s.of for s in engine.scaled}
    fitted = {s.name: s.of * float(np.exp(value)) for s, value in zip(engine.scaled, phi, strict=True)}
    for actuator in engine.machine.actuators:
        kp = f"kp {actuator.name}"
        if (joint := actuator.joint) is not None and kp in fitted:
            held, damping = float(load[engine.machine.joints.index(joint)]), f"damping {joint.name}"
            pair = [(held / v[kp], v.get(damping, 0.0) / v[kp]) for v in (nominal, fitted)]
            (nominal_sag, nominal_lag), (sag, lag) = pair
            found.append(ServoError(joint.name, joint.unit, held, nominal_sag, sag, nominal_lag, lag))
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


def words(found: Sequence[ServoError], time_step: float) -> str:
    """Sentences on servos that visibly sag or lag otherwise than the model says; empty if there is none.

    time_step: interval between rows [s].
    """
    sagging = _sentence(
        "At rest, servos sag under the weight that they hold", "sag", [s.joint for s in found],
        [(s.nominal_sag, s.sag) for s in found], SAG_SHOWS, lambda i, sag: f"{number(1000 * sag, 2)} m{found[i].unit}",
    )  # fmt: skip
    lagging = _sentence(
        "In steady motion, servos are behind their commands", "follow", [s.joint for s in found],
        [(s.nominal_lag, s.lag) for s in found], LAG_SHOWS * time_step, lambda _, lag: f"{number(1000 * lag, 2)} ms",
    )  # fmt: skip
    return " ".join(filter(None, [sagging, lagging]))


def _sentence(
    start: str,
    verb: str,
    joints: Sequence[str],
    pairs: Sequence[tuple[float, float]],
    shows: float,
    size: Callable[[int, float], str],
) -> str:
    """The joints whose fitted value differs from that of the model by more than `shows`, greatest difference first."""
    apart = [abs(fitted - nominal) for nominal, fitted in pairs]
    visible = sorted((i for i, d in enumerate(apart) if d > shows), key=lambda i: -apart[i])
    if not visible:
        return ""
    each = [f"{joints[i]} by {size(i, pairs[i][1])} ({size(i, pairs[i][0])} in the model)" for i in visible]
    others = [joint for i, joint in enumerate(joints) if i not in visible]
    elsewhere = f" The others ({', '.join(others)}) {verb} as in the model." if others else ""
    return f"{start}: {', '.join(each)}.{elsewhere}"
