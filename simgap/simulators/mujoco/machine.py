"""The part of a model that can be diagnosed with given columns: joints and actuators; and what happens to the rest."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
from collections.abc import Collection
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from simgap.simulators.mujoco.floating import FREE, parts
from simgap.simulators.mujoco.parts import Actuator, Deflection, Follower, Joint
from simgap.types import Field, Kind, Schema, SimgapError

# A model's arrays hold integers, for which `x in (enum, ...)` is false.
HINGE, SLIDE = (int(getattr(mujoco.mjtJoint, f"mjJNT_{name}")) for name in ("HINGE", "SLIDE"))
AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
_TIED = int(mujoco.mjtEq.mjEQ_JOINT)


@dataclass(frozen=True)
class Machine:
    """The part of a model that a diagnosis works on.

    held: degrees of freedom that are held still at the `reference`, a vector of positions. controls: values for
    actuators whose command is not recorded. notes: what cannot be diagnosed, in words. deflection: of the joint that is
    split into motor and link, if one is.
    """

    joints: tuple[Joint, ...]
    actuators: tuple[Actuator, ...]
    followers: tuple[Follower, ...]
    held: tuple[int, ...]
    reference: Float[np.ndarray, " nq"]
    controls: Float[np.ndarray, " nu"]
    notes: tuple[str, ...]
    deflection: Deflection | None = None

    @property
    def schema(self) -> Schema:
        """Positions, recorded velocities, other velocities, states of actuators, deflection; and the commands."""
        position = [Field(f"{j.name}_pos", j.unit, j.kind, "body", j.name, j.axis) for j in self.joints]
        velocity = [
            Field(f"{j.name}_vel", f"{j.unit}/s", "velocity", "body", j.name, j.axis, j.speed_recorded, j.effort)
            for j in self.joints
        ]
        slow = [a.name for a in self.actuators if a.act is not None]
        hidden = [Field(f"act_{name}", "-", "force", "body", observed=False) for name in slow]
        velocity.sort(key=lambda f: not f.observed)
        if self.deflection is not None:
            joint = self.joints[self.deflection.joint]
            # Their kind is none that a law of motion acts on. The change per row has the unit of an innovation.
            hidden += [Field(f"{joint.name}_{what}", joint.unit, "force", "body", joint.name, joint.axis, False)
                       for what in ("deflection", "deflection_per_row")]  # fmt: skip
        return Schema((*position, *velocity, *hidden), tuple(_command(a) for a in self.actuators))


def count(model: mujoco.MjModel) -> int:
    """The number of actuators. `nu` is that of controls: since MuJoCo 4, one actuator may take several."""
    return len(model.actuator_gainprm)


def acts_on(model: mujoco.MjModel, a: int) -> int:
    """Index of the joint that an actuator acts on, -1 where it acts on something else."""
    return int(model.actuator_trnid[a, 0]) if model.actuator_trntype[a] in _JOINTS else -1


def ranges(model: mujoco.MjModel, machine: Machine) -> dict[str, tuple[float, float]]:
    """Ends of the range of every joint that has one, by name [rad, m]."""
    limited = [j for j in machine.joints if model.jnt_limited[j.index]]
    return {j.name: (float(model.jnt_range[j.index][0]), float(model.jnt_range[j.index][1])) for j in limited}


def _command(actuator: Actuator) -> Field:
    joint = actuator.joint
    name = f"cmd_{actuator.name}"
    if joint is None:
        return Field(name, "-", actuator.kind, "body")
    unit = {"position": joint.unit, "velocity": f"{joint.unit}/s"}.get(actuator.kind, joint.effort)
    return Field(name, unit, actuator.kind, "body", joint.name, joint.axis)


def machine(model: mujoco.MjModel, columns: Collection[str] | None, floating: Collection[str] = ()) -> Machine:
    """What can be diagnosed with recordings that have these columns; None: all columns that the model could have.

    floating: names of joints in place of free ones.

    Raises:
        SimgapError: no joint is left.
    """
    scalar = [j for j in range(model.njnt) if model.jnt_type[j] in (HINGE, SLIDE)]
    coupled = _couplings(model)
    names = {j: model.joint(j).name for j in range(model.njnt)}
    if columns is None:
        recorded = [j for j in scalar if j not in coupled]
        columns = {f"{names[j]}_{what}" for j in recorded for what in ("pos", "vel")}
        columns |= {f"cmd_{model.actuator(a).name}" for a in range(count(model))}
    recorded = [j for j in scalar if f"{names[j]}_pos" in columns]
    if not recorded:
        free = [names[j] for j in range(model.njnt) if model.jnt_type[j] == FREE]
        could = (*(names[j] for j in scalar), *(part for name in free for part in parts(name)))
        raise SimgapError(
            "No joint of the model can be diagnosed: the recordings need a column <joint>_pos for at least one of: "
            f"{', '.join(could) or '(the model has no joint but ball joints)'}."
        )
    joints = tuple(_joint(model, j, f"{names[j]}_vel" in columns, names[j] in floating) for j in recorded)
    follows = {j: f for j, f in coupled.items() if j not in recorded and f[0] in recorded}
    followers = tuple(
        Follower(int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j]), recorded.index(leader), polynomial)
        for j, (leader, polynomial) in follows.items()
    )
    left = [j for j in range(model.njnt) if j not in recorded and j not in follows]
    actuators, idle = _actuators(model, {j.index: j for j in joints}, columns)
    notes = [
        *(
            f"the joint {names[j]} follows {names[leader]} by an equality constraint"
            for j, (leader, _) in follows.items()
        ),
        *(_held_note(model, j, names[j]) for j in left),
        *(f"the control of the actuator {model.actuator(a).name} stays at its reference value: {why}"
          for a, why in idle),
        *(f"the delay of the actuator {a.name}, {model.actuator_delay[a.index]:g} s, is left out; a delay that is "
          "found includes it" for a in actuators if _delayed(model, a)),
    ]  # fmt: skip
    dofs = [int(d) for j in left for d in np.flatnonzero(model.dof_jntid == j)]
    reference, controls = _reference(model)
    return Machine(joints, actuators, followers, tuple(dofs), reference, controls, tuple(notes))


def _delayed(model: mujoco.MjModel, actuator: Actuator) -> bool:
    """Whether the model delays an actuator, as it can since MuJoCo 3.5."""
    return bool(model.actuator_delay[actuator.index])


def _joint(model: mujoco.MjModel, j: int, speed: bool, floating: bool) -> Joint:
    hinge, first = bool(model.jnt_type[j] == HINGE), (int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j]))
    return Joint(model.joint(j).name, j, *first, hinge, speed, floating)


def _held_note(model: mujoco.MjModel, j: int, name: str) -> str:
    if model.jnt_type[j] in (HINGE, SLIDE):
        return f"the joint {name} has no column {name}_pos; it is held still and not diagnosed"
    if model.jnt_type[j] != FREE:
        return f"the ball joint {name} is held still and not diagnosed"
    return (
        f"the free joint {name} is held still and not diagnosed: there is no column of its position or angles, such as "
        f"{parts(name)[0]}_pos, or its body is tilted in the model's own pose"
    )


def _couplings(model: mujoco.MjModel) -> dict[int, tuple[int, tuple[float, ...]]]:
    """For each joint that an equality constraint ties to another: the other one, and the polynomial of the offset."""
    couplings: dict[int, tuple[int, tuple[float, ...]]] = {}
    for e in np.flatnonzero((model.eq_type == _TIED) & (model.eq_active0 != 0)):
        one, other = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if other >= 0:
            couplings[one] = (other, tuple(map(float, model.eq_data[e, :5])))
    return couplings


def _actuators(
    model: mujoco.MjModel, joints: dict[int, Joint], columns: Collection[str]
) -> tuple[tuple[Actuator, ...], list[tuple[int, str]]]:
    """Actuators that can be diagnosed; and the others, each with the reason."""
    usable: list[Actuator] = []
    idle: list[tuple[int, str]] = []
    for a in range(count(model)):
        name = model.actuator(a).name
        at = acts_on(model, a)
        joint = joints.get(at)
        first, controls = _controls(model, a)
        if f"cmd_{name}" not in columns:
            idle.append((a, f"there is no column cmd_{name}"))
        elif at >= 0 and joint is None:
            idle.append((a, "the position of its joint is not recorded"))
        elif controls != 1:
            idle.append((a, f"it takes {controls} controls"))
        else:
            act = int(model.actuator_actadr[a])
            usable.append(Actuator(name, a, first, act if act >= 0 else None, _kind(model, a), joint))
    return tuple(usable), idle


def _controls(model: mujoco.MjModel, a: int) -> tuple[int, int]:
    """Index of the first control of an actuator, and their number; before MuJoCo 4 it is one."""
    if hasattr(model, "actuator_ctrladr"):
        return int(model.actuator_ctrladr[a]), int(model.actuator_ctrlnum[a])
    return a, 1


def _kind(model: mujoco.MjModel, a: int) -> Kind:
    """Kind of an actuator's command, from the law of its force: gain * command + b1 * length + b2 * velocity."""
    if model.actuator_biastype[a] != AFFINE:
        return "force"
    stiff, damped = model.actuator_biasprm[a, 1:3]
    if stiff:
        return "velocity" if model.actuator_dyntype[a] == _INTEGRATOR else "position"
    return "velocity" if damped and np.isclose(model.actuator_gainprm[a, 0], -damped) else "force"


def _reference(model: mujoco.MjModel) -> tuple[Float[np.ndarray, " nq"], Float[np.ndarray, " nu"]]:
    """Positions and controls of the first keyframe; without one, the model's own positions with servos at rest."""
    if model.nkey:
        return model.key_qpos[0].copy(), model.key_ctrl[0].copy()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    controls = np.zeros(model.nu)
    for a in range(count(model)):
        if _kind(model, a) == "position":
            controls[_controls(model, a)[0]] = data.actuator_length[a]
    return model.qpos0.copy(), controls
