"""Parameters and terms, set in a copy of an engine's model."""

from __future__ import annotations

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from jaxtyping import Float

from simgap.simulators.mujoco.attributes import Scaled
from simgap.simulators.mujoco.terms import Added, Deflecting, Switch, Timed, force_range

if TYPE_CHECKING:
    from simgap.simulators.mujoco.engine import MujocoEngine

HELD = 1e10
"""Armature of a joint that is held still: no torque moves it."""
_WITHOUT_SLOTS = {"actuator_forcerange", "actuator_forcelimited", "dof_armature"}
"""Arrays that force limits and joints that are held still change."""
DAMPED = 0.05
"""Damping ratio of a spring between motor and link: that of a metal gear; the recordings hardly show it."""


def arrays(scaled: Sequence[Scaled], switches: Sequence[Switch]) -> tuple[str, ...]:
    """Names of the arrays that these parameters and terms change."""
    slots = [s for part in (*scaled, *switches) if isinstance(part, Scaled | Added) for s in part.slots]
    return tuple(sorted({*_WITHOUT_SLOTS, *(slot.array for slot in slots)}))


def apply(
    engine: MujocoEngine,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    phi: Float[np.ndarray, " p"],
    terms: Float[np.ndarray, " k"],
) -> None:
    """Set parameters and terms in a copy of the engine's model, whatever was set there before."""
    own = engine.model
    model.opt.timestep = own.opt.timestep
    for name in engine.changed:
        getattr(model, name)[:] = getattr(own, name)
    for scaled, value in zip(engine.scaled, phi, strict=True):
        for slot in scaled.slots:
            getattr(model, slot.array)[slot.index] *= np.exp(value)
    for switch, value in zip(engine.switches, terms, strict=True):
        if isinstance(switch, Added):
            for slot in switch.slots:
                getattr(model, slot.array)[slot.index] += value
        elif isinstance(switch, Timed):
            model.opt.timestep += value / engine.steps
        elif isinstance(switch, Deflecting):
            _deflect(model, switch, float(value))
        elif value > 0:
            model.actuator_forcerange[switch.index] = force_range(own, switch.index, value)
            model.actuator_forcelimited[switch.index] = True
    mujoco.mj_setConst(model, data)  # what MuJoCo derives from masses and armatures
    model.dof_armature[list(engine.machine.held)] += HELD


def _deflect(model: mujoco.MjModel, switch: Deflecting, value: float) -> None:
    """Set the gap of a split joint, or its spring. At zero it hardly moves."""
    if switch.term.effect == "link_backlash":
        model.jnt_range[switch.index] = -value / 2, value / 2
        return
    stiffness = 1 / max(value, switch.term.low)
    model.jnt_stiffness[switch.index] = stiffness
    model.dof_damping[switch.dof] = 2 * DAMPED * np.sqrt(stiffness * switch.inertia)
