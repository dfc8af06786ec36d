"""Reads an MJCF or URDF as it is: names unnamed elements, and drops missing files that only pictures need."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import mujoco

from simgap.types import SimgapError

INERTIA_FROM_GEOM = int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE)
"""Compiler option: masses come from geoms even where a body has an inertial element."""
PerJoint = float | Mapping[str, float] | None
"""A value for all joints, or for some by name."""


@dataclass(frozen=True)
class Servos:
    """Position servos for joints without an actuator, as in a URDF: for all such joints, or for some by name.

    kp: stiffness [N m/rad, N/m]. kv: damping by the servo [N m s/rad, N s/m]. force_limit: [N m, N].
    """

    kp: PerJoint = None
    kv: PerJoint = None
    force_limit: PerJoint = None

    def of(self, option: str, joint: str) -> float | None:
        """The value of an option at a joint."""
        values = getattr(self, option)
        return values.get(joint) if isinstance(values, Mapping) else values


NO_SERVOS = Servos()


@dataclass(frozen=True)
class Source:
    """An uncompiled model in which every body, joint and actuator has a name. notes: what was left out, in words.

    file: the model as it was read. spec: the same with the joints `floating` in place of free ones (see `floating`).
    """

    file: mujoco.MjSpec
    notes: tuple[str, ...]
    spec: mujoco.MjSpec
    floating: tuple[str, ...] = ()


def read(model: str | Path | mujoco.MjSpec, servos: Servos) -> Source:
    """Read a model from a file, or copy one that was read.

    Raises:
        SimgapError: it cannot be read or compiled, or a servo is for a joint that is missing or has an actuator.
    """
    spec = model.copy() if isinstance(model, mujoco.MjSpec) else _from_file(Path(model))
    spec.compiler.fusestatic = False  # fusing the fixed links of a URDF would remove their names
    _name(spec)
    notes = _drop_missing_files(spec)
    _add_servos(spec, servos)
    compiled(spec)
    return Source(spec, tuple(notes), spec)


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model, ready to be stepped."""
    try:
        return spec.compile()
    except ValueError as error:
        raise SimgapError(f"MuJoCo cannot compile the model: {_one_line(error)}") from error


def _from_file(path: Path) -> mujoco.MjSpec:
    if not path.is_file():
        raise SimgapError(f"{path}: there is no such file; expected an MJCF or URDF model.")
    try:
        return mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise SimgapError(f"{path}: MuJoCo cannot read this as MJCF or URDF: {_one_line(error)}") from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).removeprefix("Error: ").split())


def _name(spec: mujoco.MjSpec) -> None:
    """Name unnamed elements, so that columns and changes can refer to them."""
    for kind, elements in (("body", spec.bodies[1:]), ("joint", spec.joints), ("actuator", spec.actuators)):
        taken = {e.name for e in elements}
        for index, element in enumerate(elements):
            if not element.name:
                wanted = _wanted(kind, element)
                if not wanted or wanted in taken:
                    wanted = f"{kind}{index}"
                while wanted in taken:
                    wanted += "_"
                element.name = wanted
                taken.add(wanted)


def _wanted(kind: str, element: Any) -> str:
    """What an unnamed element is named after: an actuator after its joint, a free joint after its body."""
    if kind == "actuator":
        return element.target
    return element.parent.name if kind == "joint" and element.type == mujoco.mjtJoint.mjJNT_FREE else ""


def _drop_missing_files(spec: mujoco.MjSpec) -> list[str]:
    """Remove pictures and meshes whose file is missing, where no mass depends on them; returns notes."""
    notes: list[str] = []
    while True:
        try:
            spec.compile()
            return notes
        except ValueError as error:
            missing = re.search(r"(?:opening|resource|file) '([^']+)'", _one_line(error))
            if missing is None:
                raise SimgapError(f"MuJoCo cannot compile the model: {_one_line(error)}") from error
            name = Path(missing.group(1)).name
            if not (_drop_mesh(spec, name) or _drop_texture(spec, name)):
                raise SimgapError(f"The model needs the file {missing.group(1)}, which is missing.") from error
            notes.append(f"the file {missing.group(1)} is missing; the model is used without it")


def _drop_mesh(spec: mujoco.MjSpec, file: str) -> bool:
    meshes = [m for m in spec.meshes if Path(m.file).name == file]
    for mesh in meshes:
        for geom in [g for g in spec.geoms if g.meshname == mesh.name]:
            if _weighs(spec, geom):
                raise SimgapError(
                    f"The mesh file {file} is missing, and the mass of the body {geom.parent.name} is computed from "
                    "it. Put the file in its place, or give the body an inertial element."
                )
            spec.delete(geom)
        spec.delete(mesh)
    return bool(meshes)


def _weighs(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    """Whether the mass or inertia of a geom's body is computed from it."""
    first, last = spec.compiler.inertiagrouprange
    given = geom.parent.explicitinertial and int(spec.compiler.inertiafromgeom) != INERTIA_FROM_GEOM
    return not given and first <= geom.group <= last and geom.mass != 0 and geom.density != 0


def _drop_texture(spec: mujoco.MjSpec, file: str) -> bool:
    textures = [t for t in spec.textures if file in {Path(f).name for f in (t.file, *t.cubefiles)}]
    for texture in textures:
        for material in spec.materials:
            for i, name in enumerate(material.textures):
                if name == texture.name:
                    material.textures[i] = ""
        spec.delete(texture)
    return bool(textures)


def _add_servos(spec: mujoco.MjSpec, servos: Servos) -> None:
    driven = {a.target for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_JOINT}
    free = [j for j in spec.joints if j.name not in driven and _scalar(j)]
    names = {j.name for j in free}
    for option in (f.name for f in fields(Servos)):
        values = getattr(servos, option)
        for name in values if isinstance(values, Mapping) else ():
            if name not in names:
                raise SimgapError(
                    f"{option}: no joint {name} without an actuator; there are: {', '.join(sorted(names))}."
                )
    for joint in free:
        kp = servos.of("kp", joint.name)
        if kp is None:
            continue
        actuator = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=kp, kv=servos.of("kv", joint.name) or 0.0)
        limit = servos.of("force_limit", joint.name)
        if limit is not None:
            actuator.forcelimited, actuator.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-limit, limit]


def _scalar(joint: mujoco.MjsJoint) -> bool:
    return joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
