"""A model with the findings of a diagnosis written into it, and the list of changes."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.

from collections.abc import Mapping
from dataclasses import dataclass
from os import path
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from jaxtyping import Float

from simgap.simulators.mujoco import payloads
from simgap.simulators.mujoco.attributes import Slot, unit
from simgap.simulators.mujoco.engine import MujocoEngine
from simgap.simulators.mujoco.floating import FREE
from simgap.simulators.mujoco.reading import compiled
from simgap.simulators.mujoco.split import second_joint
from simgap.simulators.mujoco.steps import LONGER
from simgap.simulators.mujoco.terms import Added, Deflecting, Limited, Timed, force_range

_NONE = int(mujoco.mjtDyn.mjDYN_NONE)


@dataclass(frozen=True)
class Change:
    """One attribute of one element: its value before and after, as in XML."""

    element: str
    attribute: str
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.element}: {self.attribute} {self.before} -> {self.after}"


@dataclass(frozen=True)
class Patched:
    """A model's XML, the changes in it, and the findings that could not be written, in words."""

    xml: str
    changes: tuple[Change, ...]
    unwritten: tuple[str, ...]


def patch(
    engine: MujocoEngine,
    phi: Float[np.ndarray, " p"],
    terms: Float[np.ndarray, " k"],
    folder: Path,
    delays: Mapping[str, float] | None = None,
    lags: Mapping[str, float] | None = None,
) -> Patched:
    """The model with fitted parameters and terms, for a file in `folder`: paths of meshes are relative to it.

    delays, lags: of the commands of actuators, by actuator name [s].
    """
    spec = engine.source.file.copy()
    _spell_out(engine, spec)
    unwritten: list[str] = []
    changes = [
        *_scaled(engine, spec, np.asarray(phi, float)),
        *_switched(engine, spec, np.asarray(terms, float), unwritten),
        *_delayed(spec, delays or {}),
        *_lagging(spec, lags or {}, unwritten),
    ]
    compiled(spec)  # before MuJoCo 4, only a compiled model can be written as XML
    return Patched(_xml(spec, folder), tuple(changes), tuple(unwritten))


def _spell_out(engine: MujocoEngine, spec: mujoco.MjSpec) -> None:
    """Replace springs and dampers that MuJoCo computes from a time constant by numbers that can be changed."""
    for joint in (j for j in spec.joints if j.type != FREE):
        if np.any(np.asarray(joint.springdamper) > 0):
            built = engine.model.joint(joint.name)
            joint.springdamper = [0.0, 0.0]
            for slot in (Slot("jnt_stiffness", (built.id,), "joint", joint.name, "stiffness"),
                         Slot("dof_damping", (int(built.dofadr[0]),), "joint", joint.name, "damping")):  # fmt: skip
                slot.write(spec, slot.value(engine.model))


def _scaled(engine: MujocoEngine, spec: mujoco.MjSpec, phi: Float[np.ndarray, " p"]) -> list[Change]:
    changes = []
    for scaled, value in zip(engine.scaled, phi, strict=True):
        for slot in scaled.slots if value else ():
            changes.append(_set(engine, spec, slot, slot.value(engine.model) * float(np.exp(value))))
    # A servo's gain and stiffness are a single number in MJCF: kp.
    return list(dict.fromkeys(changes))


def _switched(
    engine: MujocoEngine, spec: mujoco.MjSpec, terms: Float[np.ndarray, " k"], unwritten: list[str]
) -> list[Change]:
    changes = []
    for switch, value in zip(engine.switches, map(float, terms), strict=True):
        if value == 0:
            continue
        if isinstance(switch, Limited):
            changes.append(_limit(engine, spec, switch, value))
        elif isinstance(switch, Timed):
            unwritten.append(f"rows {engine.time_step + value:.6g} s apart: that is a matter of the recordings")
        elif isinstance(switch, Deflecting):
            changes += _deflect(engine, spec, switch, value)
        elif switch.term.effect == "payload" and spec.compiler.settotalmass > 0:
            unwritten.append(f"payload of {value:.6g} kg at {switch.term.where}: the model sets its total mass")
        elif switch.term.effect == "payload":
            changes.append(_load(engine, spec, switch, value))
        elif switch.term.where in engine.source.floating:
            unwritten.append(
                f"{switch.term.effect} at {switch.term.where}: MJCF has no such number for a single axis of "
                "a free joint"
            )
        else:
            changes += [_set(engine, spec, s, s.value(engine.model) + value) for s in switch.slots]
    return changes


def _set(engine: MujocoEngine, spec: mujoco.MjSpec, slot: Slot, value: float) -> Change:
    slot.write(spec, value)
    before, word = slot.value(engine.model), slot.attribute
    if word == "biasprm":  # MJCF's kp and kv, with the sign of a resistance
        before, value, word = -before, -value, "kp" if slot.component == 1 else "kv"
    elif word == "gainprm":
        word = "kp" if engine.model.actuator_biasprm[slot.index[0], 1] else "kv"
    return Change(f"{slot.element} {slot.name}", word, _number(before), _number(value))


def _limit(engine: MujocoEngine, spec: mujoco.MjSpec, switch: Limited, value: float) -> Change:
    limited = engine.model.actuator_forcelimited[switch.index]
    before = _range(engine.model.actuator_forcerange[switch.index]) if limited else "none"
    after = force_range(engine.model, switch.index, value)
    actuator = spec.actuator(switch.name)
    actuator.forcelimited, actuator.forcerange = int(mujoco.mjtLimited.mjLIMITED_TRUE), after
    return Change(f"actuator {switch.name}", "forcerange", before, _range(after))


def _load(engine: MujocoEngine, spec: mujoco.MjSpec, switch: Added, mass: float) -> Change:
    (slot,) = switch.slots
    carrier, centre = switch.term.where, engine.model.body_pos[slot.index[0]]
    name, taken = f"payload_{carrier}", {body.name for body in spec.bodies}
    while name in taken:
        name += "_"
    payloads.add(spec, name, carrier, (float(centre[0]), float(centre[1]), float(centre[2])), mass)
    at = " ".join(map(_number, centre))
    return Change(f"body {carrier}", "payload", "none", f"a body {name} of mass {_number(mass)} at {at}")


def _deflect(engine: MujocoEngine, spec: mujoco.MjSpec, switch: Deflecting, value: float) -> list[Change]:
    """A second joint with the numbers with which the engine has stepped it, and what it needs of the model: a rotor
    with inertia, steps as short as the engine's, and keyframes with a place for it."""
    at, joint, longest = engine.machine.deflection, spec.joint(switch.term.where), float(engine.model.opt.timestep)
    assert at is not None  # where the engine has such a term
    own = compiled(spec.copy()).joint(joint.name)
    places = {"qpos": int(own.qposadr[0]) + 1, "qvel": int(own.dofadr[0]) + 1}
    added = second_joint(spec, joint.name)
    terms = np.array([0.0] * (len(engine.switches) - 1) + [value])
    size = _size(engine, spec, added, engine.compiled(engine.nominal, terms))
    measured = f"{joint.name} + {added.name}" if at.at_link else joint.name
    changes = [Change(f"joint {joint.name}", "second joint", "none",
                      f"{added.name}, {size}; the measured position is {measured}")]  # fmt: skip
    if not joint.armature:
        rotor = Slot("dof_armature", (engine.machine.joints[at.joint].dof,), "joint", joint.name, "armature")
        rotor.write(spec, rotor.value(engine.model))
        changes.append(Change(f"joint {joint.name}", "armature", "0", _number(joint.armature)))
    if spec.option.timestep > LONGER * longest:
        changes.append(Change("option", "timestep", _number(spec.option.timestep), _number(longest)))
        spec.option.timestep = longest
    for key in spec.keys:
        for part, index in places.items():
            if len(values := getattr(key, part)):
                setattr(key, part, np.insert(values, index, 0.0))
                changes.append(Change(f"key {key.name}", part, f"{len(values)} values", f"0 for {added.name} too"))
    return changes


def _size(engine: MujocoEngine, spec: mujoco.MjSpec, added: mujoco.MjsJoint, built: mujoco.MjModel) -> str:
    """Write the stops, the spring and all else of a compiled model's deflection; returns it in words."""
    at = engine.machine.deflection
    assert at is not None  # where there is a second joint
    joint, said = engine.machine.joints[at.joint], []
    added.limited = int(mujoco.mjtLimited.mjLIMITED_FALSE)
    if built.jnt_limited[at.index]:
        ends = built.jnt_range[at.index]
        turns = np.degrees(ends) if joint.hinge and spec.compiler.degree else ends
        added.limited, added.range = int(mujoco.mjtLimited.mjLIMITED_TRUE), [float(f"{end:.9g}") for end in turns]
        added.solref_limit = built.jnt_solref[at.index]
        said.append(f"range {_range(ends)} {joint.unit}")
    added.springdamper = [0.0, 0.0]  # would replace the two that follow
    for kind in ("stiffness", "damping", "frictionloss", "armature"):
        array, index = ("jnt_stiffness", at.index) if kind == "stiffness" else (f"dof_{kind}", at.dof)
        slot = Slot(array, (index,), "joint", added.name, kind)
        slot.write(spec, slot.value(built))
        if value := slot.value(built):
            said.append(f"{kind} {_number(value)} {unit(joint, kind)}")
    return ", ".join(said)


def _delayed(spec: mujoco.MjSpec, delays: Mapping[str, float]) -> list[Change]:
    changes = []
    for name, delay in delays.items():
        actuator = spec.actuator(name)
        changes.append(Change(f"actuator {name}", "delay", _number(actuator.delay), _number(delay)))
        # The buffer holds one sample a time step of the model.
        actuator.delay, actuator.nsample = delay, int(np.ceil(delay / spec.option.timestep)) + 1
    return changes


def _lagging(spec: mujoco.MjSpec, lags: Mapping[str, float], unwritten: list[str]) -> list[Change]:
    changes = []
    for name, lag in lags.items():
        actuator = spec.actuator(name)
        if int(actuator.dyntype) == _NONE:
            actuator.dyntype, actuator.dynprm[0] = mujoco.mjtDyn.mjDYN_FILTEREXACT, lag
            changes.append(Change(f"actuator {name}", "dyntype", "none", f"filterexact, time constant {_number(lag)}"))
        else:
            unwritten.append(f"lag of {_number(lag)} s at {name}: the actuator has dynamics of its own")
    return changes


def _xml(spec: mujoco.MjSpec, folder: Path) -> str:
    """Numbers and classes as originally written, where MuJoCo can (3.16 and later); paths relative to the folder."""
    for option in ("savecompiled", "savecanonical"):
        if hasattr(spec.compiler, option):
            setattr(spec.compiler, option, False)
    xml = spec.to_xml()
    if not spec.modelfiledir or not (spec.meshes or spec.textures or spec.hfields or spec.skins):
        return xml
    root = ElementTree.fromstring(xml)
    options = root.find("compiler")
    if options is None:
        options = ElementTree.SubElement(root, "compiler")
    for where in ("meshdir", "texturedir"):
        meant = path.join(path.abspath(spec.modelfiledir), options.get(where, ""))
        options.set(where, path.relpath(meant, path.abspath(folder)))
    return ElementTree.tostring(root, encoding="unicode")


def _number(value: float) -> str:
    return f"{value:.6g}"


def _range(values: tuple[float, float]) -> str:
    return " ".join(map(_number, values))
