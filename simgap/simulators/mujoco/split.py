"""Engines with a joint split in two: the motor's side, and a deflection of the link against it, which is hidden.

A second joint along the same axis in the same body is the deflection: play where it has stops, elastic where it has a
spring. The servo, damping and armature stay at the motor.
"""

from __future__ import annotations

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from simgap.effects.behind_joints import BEHIND_JOINTS
from simgap.engines import Term
from simgap.simulators.mujoco import payloads
from simgap.simulators.mujoco.attributes import parameters
from simgap.simulators.mujoco.machine import Machine, machine
from simgap.simulators.mujoco.parts import Deflection
from simgap.simulators.mujoco.ready import ready
from simgap.simulators.mujoco.terms import Deflecting, switches
from simgap.types import SimgapError

if TYPE_CHECKING:
    from simgap.simulators.mujoco.engine import MujocoEngine

GAPS = {True: (0.006, 0.012, 0.025, 0.05, 0.1), False: (6e-4, 1.2e-3, 2.5e-3, 5e-3, 0.01)}
"""Gaps from which a search starts: of a hinge [rad], from a precise gear to a worn one; of a slide [m], the same
at a lever of 0.1 m."""
SHARES = (0.125, 0.25, 0.5, 1.0)
"""Natural frequencies of the link on its spring from which a search starts, as shares of the Nyquist frequency of the
rows: recordings cannot show stiffer ones."""
ROTOR = 0.05
"""Inertia of the motor's side, as a share of the joint's, where the model gives it none: without any it could not be
stepped."""
TINY = 1e-6
"""Armature with which such a model compiles without a warning [kg m^2, kg]."""
FINER = 2
"""Factor by which steps are shortened: a stop is stiffer than a servo."""
SHARPEST = 2.0
"""Time constant of a stop, in steps: MuJoCo allows no stiffer one."""
DEFLECTION = "_deflection"
"""What the name of the second joint has after that of the first."""
_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)


def deflecting(engine: MujocoEngine, joint: str) -> tuple[MujocoEngine, ...]:
    """The engine with play, and with a spring, behind a joint; each with the encoder at the link and at the motor.

    The last term is the gap or the compliance; all others, and the parameters, are those of the engine, in its order.
    Empty if the joint cannot be split: it is one of a free joint, another joint of its body comes after it, or the
    model does not compile.
    """
    spec = engine.source.spec.copy()
    own = spec.joint(joint)
    if own is None or joint in engine.source.floating or spec.joint(f"{joint}{DEFLECTION}") is not None:
        return ()
    if list(own.parent.joints)[-1].name != joint:
        return ()
    bare = own.armature == 0
    own.armature = own.armature or TINY
    name = second_joint(spec, joint).name
    for key in list(spec.keys):
        spec.delete(key)  # their positions lack the deflection
    columns = {f.name for f in (*engine.schema.outputs, *engine.schema.command)}
    try:
        plain = spec.copy().compile()
        robot = machine(plain, columns, engine.source.floating)
        model = ready(spec, payloads.places(plain, robot))
    except (ValueError, SimgapError):
        return ()
    added = model.joint(name)
    index, qpos, dof = int(added.id), int(added.qposadr[0]), int(added.dofadr[0])
    robot = replace(
        robot, held=tuple(d for d in robot.held if d != dof), notes=engine.machine.notes,
        reference=np.insert(engine.machine.reference, qpos, 0.0), controls=engine.machine.controls,
    )  # fmt: skip
    which = [j.name for j in robot.joints].index(joint)
    model.dof_armature[robot.joints[which].dof] *= not bare  # a parameter only where the model sets it
    here = [Deflection(which, index, qpos, dof, at_link) for at_link in (True, False)]
    found = [_one(engine, model, replace(robot, deflection=at), effect) for effect in BEHIND_JOINTS for at in here]
    return tuple(e for e in found if e is not None)


def _one(engine: MujocoEngine, model: mujoco.MjModel, robot: Machine, effect: str) -> MujocoEngine | None:
    """The engine with one kind of deflection; None if its parameters or terms are not those of the engine."""
    at, steps = robot.deflection, FINER * engine.steps
    assert at is not None  # the caller gives one
    joint = robot.joints[at.joint]
    scaled, switched = parameters(model, robot), switches(model, robot, engine.time_step)
    same = [s.name for s in scaled] == [s.name for s in engine.scaled]
    if not same or [(s.term.effect, s.term.where) for s in switched] != [(t.effect, t.where) for t in engine.terms]:
        return None
    model = copy.copy(model)
    whole = float(model.dof_M0[joint.dof])
    if not model.dof_armature[joint.dof]:
        model.dof_armature[joint.dof] = ROTOR * whole
    model.opt.timestep, model.opt.integrator = engine.time_step / steps, _RK4
    if effect == "link_backlash":
        model.jnt_limited[at.index] = True
        model.jnt_solref[at.index] = SHARPEST * model.opt.timestep, 1.0
    inertia = max(whole - float(model.dof_armature[joint.dof]), ROTOR * whole)
    columns = [f"{joint.name}_{what}" for what in ("pos", "vel")]
    channels = tuple(f"cmd_{a.name}" for a in robot.actuators if a.joint is joint)
    nyquist = np.pi / engine.time_step
    starts = GAPS[joint.hinge] if effect == "link_backlash" else [1 / (inertia * (s * nyquist) ** 2) for s in SHARES]
    constant, unit, says = BEHIND_JOINTS[effect]
    starts = tuple(sorted(map(float, starts)))
    term = Term(effect, joint.name, tuple(columns), channels, constant, unit.format(u=joint.unit, force=joint.effort),
                starts[0] / 4, 4 * starts[-1], starts, says, reciprocal=effect == "elastic_joint",
                form="link" if at.at_link else "motor")  # fmt: skip
    return replace(
        engine, model=model, machine=robot, steps=steps, rough_steps=steps, scaled=scaled,
        switches=(*switched, Deflecting(term, at.index, at.dof, inertia)),
    )  # fmt: skip


def second_joint(spec: mujoco.MjSpec, joint: str) -> mujoco.MjsJoint:
    """Add the deflection of a joint to an uncompiled model, with the model's defaults for joints."""
    own = spec.joint(joint)
    return own.parent.add_joint(name=f"{joint}{DEFLECTION}", type=own.type, axis=own.axis, pos=own.pos)
