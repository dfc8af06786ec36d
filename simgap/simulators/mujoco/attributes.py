"""The numbers of a model that a diagnosis changes, both in the compiled model and in its XML.

An attribute that the model sets is a parameter: the logarithm of a scale on the model's value. An attribute that the
model leaves at zero is a term, which is added to it.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
from dataclasses import dataclass

import mujoco
import numpy as np

from simgap.diagnosis.report.names import number
from simgap.simulators.mujoco.machine import AFFINE, Machine, acts_on, count
from simgap.simulators.mujoco.parts import Actuator, Joint
from simgap.simulators.mujoco.payloads import PREFIX
from simgap.types import Parameter

WIDE, WIDE_IF_FAR = float(np.log(3.0)), float(np.log(10.0))
"""A parameter may lie between a third of its nominal value and three times it; between a tenth and ten times it in a
model that is far off, which is started from values that are known roughly. A range that is too narrow looks like
missing physics."""


@dataclass(frozen=True)
class Slot:
    """One number: `array[index]` in a compiled model; in XML, `attribute` of the element of this kind and name.

    component: its index in an attribute that is a list.
    """

    array: str
    index: tuple[int, ...]
    element: str
    name: str
    attribute: str
    component: int | None = None

    def value(self, model: mujoco.MjModel) -> float:
        """Its value in a compiled model."""
        return float(getattr(model, self.array)[self.index])

    def write(self, spec: mujoco.MjSpec, value: float) -> None:
        """Set it in an uncompiled model, with nine digits."""
        value = float(f"{value:.9g}")
        element = getattr(spec, self.element)(self.name)
        current = getattr(element, self.attribute)
        if self.component is None and np.ndim(current) == 0:
            setattr(element, self.attribute, value)
        else:  # since MuJoCo 4, dampings and stiffnesses are polynomials; their first coefficient is set
            current[self.component or 0] = value


@dataclass(frozen=True)
class Scaled:
    """A parameter: the values in `slots` are scaled together. of: value, in `unit`, at a scale of 1."""

    name: str
    unit: str
    of: float
    slots: tuple[Slot, ...]

    def parameter(self, nominal: float, wide: float) -> Parameter:
        """The parameter of the search: the logarithm of the scale, up to `wide` from its nominal value."""
        return Parameter(self.name, "-", nominal - wide, nominal + wide, nominal)

    def words(self, phi: float) -> str:
        """The model's value and the fitted one: `kp shoulder_pan: 998 -> 12.1 N m/rad`."""
        return f"{self.name}: {number(self.of)} -> {number(self.of * np.exp(phi))} {self.unit}"


def parameters(model: mujoco.MjModel, machine: Machine) -> tuple[Scaled, ...]:
    """The parameters: what the model sets of its actuators and joints. Masses and geometry are taken as they are."""
    scaled = [gain for a in machine.actuators if (gain := _gain(model, a)) is not None]
    for kind in ("damping", "frictionloss", "armature", "stiffness"):
        for joint in (j for j in machine.joints if not j.floating):
            slots = joint_slots(model, joint, kind)
            size = sum(abs(s.value(model)) for s in slots)
            if size:
                scaled.append(Scaled(f"{kind} {joint.name}", unit(joint, kind), size, slots))
    compensation = float(model.body_gravcomp.max(initial=0.0))
    if compensation:
        scaled.append(Scaled("gravcomp", "", compensation, gravcomp_slots(model)))
    return tuple(scaled)


def unit(joint: Joint, kind: str) -> str:
    """Unit of a joint's attribute."""
    damping, stiffness, inertia = ("N m s/rad", "N m/rad", "kg m^2") if joint.hinge else ("N s/m", "N/m", "kg")
    return {"damping": damping, "frictionloss": joint.effort, "armature": inertia, "stiffness": stiffness}[kind]


def joint_slots(model: mujoco.MjModel, joint: Joint, kind: str) -> tuple[Slot, ...]:
    """The numbers that make up an attribute of a joint: its own, and what its actuators add.

    The damping of a position servo (kv) acts as damping of the joint.
    """
    array, index = ("jnt_stiffness", joint.index) if kind == "stiffness" else (f"dof_{kind}", joint.dof)
    slots = [Slot(array, (index,), "joint", joint.name, kind)]
    for a in range(count(model)):
        if acts_on(model, a) != joint.index:
            continue
        name = model.actuator(a).name
        if kind == "damping" and _is_servo(model, a) and model.actuator_biasprm[a, 2]:
            slots.append(Slot("actuator_biasprm", (a, 2), "actuator", name, "biasprm", 2))
        own = getattr(model, f"actuator_{kind}", None)  # since MuJoCo 4
        if own is not None and kind in ("damping", "armature") and own[a]:
            slots.append(Slot(f"actuator_{kind}", (a,), "actuator", name, kind))
    return tuple(slots)


def gravcomp_slots(model: mujoco.MjModel) -> tuple[Slot, ...]:
    """Gravity compensation of every body that moves, except added loads."""
    names = {b: model.body(b).name for b in range(1, model.nbody) if model.body_weldid[b]}
    names = {b: name for b, name in names.items() if not name.startswith(PREFIX)}
    return tuple(Slot("body_gravcomp", (b,), "body", name, "gravcomp") for b, name in names.items())


def _gain(model: mujoco.MjModel, actuator: Actuator) -> Scaled | None:
    """The stiffness of a position servo, or the gain of a velocity servo; None for a motor."""
    a, joint = actuator.index, actuator.joint
    if model.actuator_biastype[a] != AFFINE:
        return None
    servo = _is_servo(model, a)
    bias = 1 if servo else 2
    slots = [
        Slot("actuator_gainprm", (a, 0), "actuator", actuator.name, "gainprm", 0),
        Slot("actuator_biasprm", (a, bias), "actuator", actuator.name, "biasprm", bias),
    ]
    slots = [s for s in slots if s.value(model)]
    if not slots or (not servo and actuator.kind != "velocity"):
        return None
    kind = "stiffness" if servo else "damping"
    label, words = ("kp" if servo else "kv"), unit(joint, kind) if joint else "-"
    return Scaled(f"{label} {actuator.name}", words, abs(slots[-1].value(model)), tuple(slots))


def _is_servo(model: mujoco.MjModel, a: int) -> bool:
    return bool(model.actuator_biastype[a] == AFFINE and model.actuator_biasprm[a, 1])
