"""Terms: physics that a model leaves at zero and MuJoCo can compute, and the sizes at which a search starts."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from simgap.effects.timing import MISTIMED
from simgap.engines import Term
from simgap.simulators.mujoco import payloads
from simgap.simulators.mujoco.attributes import Slot, gravcomp_slots, joint_slots, unit
from simgap.simulators.mujoco.machine import Machine
from simgap.simulators.mujoco.parts import Joint

SPEED = {True: 1.0, False: 0.2}
"""Typical speed of a hinge [rad/s] and of a slide [m/s]: it turns a typical torque into a typical damping."""
ACCELERATION = {True: 5.0, False: 1.0}
"""Typical acceleration of a hinge [rad/s^2] and of a slide [m/s^2]."""
POSES = 32
"""Poses within the joints' ranges at which gravity is computed."""
STARTS = (0.05, 0.2)
"""Sizes at which a search starts, as shares of the typical size."""


@dataclass(frozen=True)
class Added:
    """A term whose constant is added to the values in `slots`."""

    term: Term
    slots: tuple[Slot, ...]


@dataclass(frozen=True)
class Limited:
    """A term whose constant is one over the maximum force of an actuator."""

    term: Term
    index: int
    name: str


@dataclass(frozen=True)
class Timed:
    """A term whose constant is added to the time between rows."""

    term: Term


@dataclass(frozen=True)
class Deflecting:
    """A term whose constant is the gap between stiff stops or the compliance of the deflection of a split joint.

    index, dof: of the deflection. inertia: of the link behind it, by which the spring is damped [kg m^2, kg].
    """

    term: Term
    index: int
    dof: int
    inertia: float


Switch = Added | Limited | Timed | Deflecting


@dataclass(frozen=True)
class _Kind:
    """A joint's attribute as an effect; `typical` gives its typical size at a joint."""

    effect: str
    attribute: str
    constant: str
    says: str
    typical: Callable[["_Scale"], float]


@dataclass(frozen=True)
class _Scale:
    """Typical values of a joint: torque [N m, N], inertia [kg m^2, kg], speed [rad/s, m/s]."""

    torque: float
    inertia: float
    speed: float


KINDS = (
    _Kind("coulomb_friction", "frictionloss", "loss",
          "dry friction: a constant resistance of {loss} works against the motion",
          lambda s: s.torque),
    _Kind("viscous_drag", "damping", "coefficient",
          "viscous drag: a resistance of {coefficient} times the speed works against the motion",
          lambda s: s.torque / s.speed),
    _Kind("added_inertia", "armature", "inertia",
          "added inertia: the joint moves {inertia} more than the model has, such as a geared rotor",
          lambda s: 2 * s.inertia),
    _Kind("joint_spring", "stiffness", "stiffness",
          "a spring of {stiffness} pulls towards the reference position",
          lambda s: s.torque / s.speed),
)  # fmt: skip
ON_FLOATING = ("viscous_drag",)
"""Effects of these that a body without a joint may have, along each axis: drag of what it moves through."""
BOUND = 5.0
"""Largest size of a joint's term, as a multiple of the typical size."""


def switches(model: mujoco.MjModel, machine: Machine, time_step: float) -> tuple[Switch, ...]:
    """All terms that the model leaves at zero, for a compiled model that includes the bodies of payloads.

    time_step: nominal interval between rows [s].
    """
    gravity = _gravity(model, machine)
    scales = {j.name: _scale(model, j, float(g)) for j, g in zip(machine.joints, gravity, strict=True)}
    terms: list[Switch] = []
    for kind in KINDS:
        for joint in (j for j in machine.joints if kind.effect in ON_FLOATING or not j.floating):
            slots = joint_slots(model, joint, kind.attribute)
            if not any(s.value(model) for s in slots):
                terms.append(Added(_joint_term(machine, joint, kind, kind.typical(scales[joint.name])), slots[:1]))
    pulled = [j for j, g in zip(machine.joints, gravity, strict=True) if g > 1e-3 * scales[j.name].torque]
    floats = any(j.floating for j in machine.joints)
    if pulled and not floats and not model.body_gravcomp.any():
        terms.append(Added(_gravity_term(machine, pulled), gravcomp_slots(model)))
    terms += _payloads(model, machine)
    terms += [limit for a in machine.actuators if (limit := _limit(model, machine, a.index, scales)) is not None]
    return (*terms, Timed(_interval_term(machine, time_step)))


def _interval_term(machine: Machine, time_step: float) -> Term:
    outputs, _ = _columns(machine, list(machine.joints))
    most, starts = MISTIMED * time_step, tuple(sign * s * time_step for s in STARTS for sign in (1, -1))
    return Term("sampling_interval", "all", outputs, (), "interval", "s", -most, most, starts,
                "the true time step is {interval}", base=time_step, shared=False, form="constant")  # fmt: skip


def _joint_term(machine: Machine, joint: Joint, kind: _Kind, typical: float) -> Term:
    outputs, channels = _columns(machine, [joint])
    return Term(
        kind.effect, joint.name, outputs, channels, kind.constant, unit(joint, kind.attribute), 0.0, BOUND * typical,
        tuple(share * typical for share in STARTS), kind.says,
    )  # fmt: skip


def _gravity_term(machine: Machine, pulled: list[Joint]) -> Term:
    """Gravity compensation as one term. MuJoCo ignores negative compensation, so the share is not negative."""
    says = "gravity compensation: the robot carries a share of {share} of its own weight, which the model lacks"
    return Term(
        "joint_gravity", "all", *_columns(machine, pulled), "share", "-", 0.0, 1.0, (0.1, 0.5), says, shared=False
    )


def _payloads(model: mujoco.MjModel, machine: Machine) -> list[Switch]:
    terms: list[Switch] = []
    for b in range(1, model.nbody):
        name = model.body(b).name
        if not name.startswith(payloads.PREFIX):
            continue
        carrier = name.removeprefix(payloads.PREFIX)
        dofs = payloads.upstream(model, b)
        moved = [j for j in machine.joints if j.dof in dofs]
        arm = [i for i in range(1, model.nbody) if payloads.upstream(model, i) & {j.dof for j in moved}]
        mass = float(model.body_mass[arm].sum())
        says = "payload: the robot carries {mass} that the model lacks"
        term = Term("payload", carrier, *_columns(machine, moved), "mass", "kg", 0.0, 2 * mass,
                    tuple(share * mass for share in STARTS), says, shared=False)  # fmt: skip
        terms.append(Added(term, (Slot("body_mass", (b,), "body", name, "mass"),)))
    return terms


def _limit(model: mujoco.MjModel, machine: Machine, index: int, scales: dict[str, _Scale]) -> Limited | None:
    """A force limit below the one that the model sets, as a greater one has no effect; None for an actuator without
    a joint."""
    actuator = next(a for a in machine.actuators if a.index == index)
    joint = actuator.joint
    if joint is None:
        return None
    own = float(np.abs(model.actuator_forcerange[index]).max()) if model.actuator_forcelimited[index] else np.inf
    typical = min(scales[joint.name].torque, 0.9 * own)
    says = "force limit: the actuator gives at most {limit}"
    term = Term("force_limit", actuator.name, *_columns(machine, [joint]), "limit", joint.effort, 1 / own, 20 / typical,
                (1 / typical, 1 / (0.6 * typical)), says, reciprocal=True)  # fmt: skip
    return Limited(term, index, actuator.name)


def force_range(model: mujoco.MjModel, index: int, reciprocal: float) -> tuple[float, float]:
    """The range of an actuator's force, within the model's range and a limit that is given as its reciprocal."""
    limit = 1 / reciprocal
    if not model.actuator_forcelimited[index]:
        return -limit, limit
    low, high = model.actuator_forcerange[index]
    return max(float(low), -limit), min(float(high), limit)


def _columns(machine: Machine, joints: list[Joint]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the states and commands of these joints."""
    outputs = [f"{j.name}_{what}" for j in joints for what in ("pos", "vel")]
    return tuple(outputs), tuple(f"cmd_{a.name}" for a in machine.actuators if a.joint in joints)


def _scale(model: mujoco.MjModel, joint: Joint, gravity: float) -> _Scale:
    """Typical values of a joint. The inertia is that in the model's own pose, including the armature."""
    inertia = float(model.dof_M0[joint.dof])
    return _Scale(gravity + inertia * ACCELERATION[joint.hinge], inertia, SPEED[joint.hinge])


def _gravity(model: mujoco.MjModel, machine: Machine) -> Float[np.ndarray, " j"]:
    """Largest gravity torque at each joint, over poses that cover the joints' ranges evenly."""
    data, most = mujoco.MjData(model), np.zeros(len(machine.joints))
    steps = np.modf(np.sqrt(np.arange(2, len(machine.joints) + 2)) * np.pi)[0]
    for pose in range(POSES):
        data.qpos[:], data.qvel[:] = machine.reference, 0.0
        for joint, share in zip(machine.joints, np.modf((pose + 1) * steps)[0], strict=True):
            if model.jnt_limited[joint.index]:
                low, high = model.jnt_range[joint.index]
            else:
                low, high = data.qpos[joint.qpos] + np.array([-1.0, 1.0]) * (np.pi if joint.hinge else 0.2)
            data.qpos[joint.qpos] = low + share * (high - low)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        bias = np.zeros(model.nv)
        mujoco.mj_rne(model, data, 0, bias)
        most = np.maximum(most, np.abs(bias[[j.dof for j in machine.joints]]))
    return most
