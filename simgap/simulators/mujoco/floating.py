"""Free joints as three slides and three hinges, so that what floats, rolls or walks is diagnosed like any joint.

A free joint `trunk` becomes `trunk_x`, `trunk_y` and `trunk_z` along the world's axes, then `trunk_yaw`, `trunk_pitch`
and `trunk_roll`, each about an axis that those before it have turned. The motion is the same, unless the pitch is a
right angle. MuJoCo's own state of a free joint has a quaternion, whose four numbers are no independent coordinates.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
from collections.abc import Collection

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from simgap.simulators.mujoco.reading import compiled
from simgap.types import SimgapError

SLIDES, HINGES = ("x", "y", "z"), ("yaw", "pitch", "roll")
"""What the names of the new joints have after that of the free joint, in their order."""
UPRIGHT = 1e-6
"""Tilt of a body in the model's own pose [sine of half the angle] up to which it counts as upright."""
FREE, _SLIDE, _HINGE = (getattr(mujoco.mjtJoint, f"mjJNT_{name}") for name in ("FREE", "SLIDE", "HINGE"))


def parts(joint: str) -> tuple[str, ...]:
    """Names of the joints that a free joint becomes."""
    return tuple(f"{joint}_{part}" for part in (*SLIDES, *HINGES))


def unfolded(spec: mujoco.MjSpec, columns: Collection[str] | None) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """A model with its free joints replaced, and the names of the new joints.

    columns: those of the recordings; a free joint without any of its positions stays, to be held still. None: all that
    the model could have. A body that is tilted in the model's own pose keeps its free joint, and so do all bodies if
    the model does not compile without one.
    """
    built = compiled(spec)
    free = [j.name for j in spec.joints if j.type == FREE]
    recorded = [n for n in free if columns is None or any(f"{part}_pos" in columns for part in parts(n))]
    wanted = [n for n in recorded if np.hypot(*_pose(built, built.qpos0, n)[4:6]) < UPRIGHT]
    if not wanted:
        return spec, ()
    trial = spec.copy()
    for name in wanted:
        _replace(trial, name, _pose(built, built.qpos0, name))
    for key, positions, controls in zip(trial.keys, built.key_qpos, built.key_ctrl, strict=True):
        key.qpos, key.ctrl = _positions(built, positions, wanted), controls
    try:
        compiled(trial)
    except SimgapError:
        return spec, ()
    return trial, tuple(part for name in wanted for part in parts(name))


def _pose(built: mujoco.MjModel, positions: Float[np.ndarray, " nq"], joint: str) -> Float[np.ndarray, " 7"]:
    """Position and quaternion of a free joint."""
    first = int(built.joint(joint).qposadr[0])
    return positions[first : first + 7]


def _angles(quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " 3"]:
    """Yaw, pitch and roll of a quaternion of MuJoCo's, whose real part comes first."""
    return Rotation.from_quat(quaternion[[1, 2, 3, 0]]).as_euler("ZYX")


def _replace(spec: mujoco.MjSpec, name: str, pose: Float[np.ndarray, " 7"]) -> None:
    """Six joints in place of a free one, which are at their reference in the model's own pose."""
    own = spec.joint(name)
    body, (yaw, *_) = own.parent, _angles(pose[3:])
    brought = {kind: np.array(getattr(own, kind)) for kind in ("armature", "frictionloss", "damping")}
    spec.delete(own)
    back = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    turn = np.degrees(yaw) if spec.compiler.degree else yaw
    places = (*zip([_SLIDE] * 3, back.T, pose[:3], strict=True),
              *zip([_HINGE] * 3, np.eye(3)[::-1], (turn, 0, 0), strict=True))  # fmt: skip
    for part, (kind, axis, at) in zip(parts(name), places, strict=True):
        joint = body.add_joint(name=part, type=kind, axis=axis, ref=at)
        joint.limited = joint.actfrclimited = int(mujoco.mjtLimited.mjLIMITED_FALSE)
        joint.springdamper = [0.0, 0.0]
        for attribute, value in {**brought, "stiffness": np.zeros_like(joint.stiffness)}.items():
            if value.ndim:  # since MuJoCo 4, dampings and stiffnesses are polynomials
                getattr(joint, attribute)[:] = value
            else:
                setattr(joint, attribute, float(value))


def _positions(
    built: mujoco.MjModel, positions: Float[np.ndarray, " nq"], replaced: list[str]
) -> Float[np.ndarray, " nq"]:
    """A keyframe's positions, with six numbers in place of a free joint's seven."""
    kept = []
    for j in range(built.njnt):
        first, joint = int(built.jnt_qposadr[j]), built.joint(j)
        last = first + len(joint.qpos0)
        own = positions[first:last]
        kept.append(np.r_[own[:3], _angles(own[3:])] if joint.name in replaced else own)
    return np.concatenate(kept)
