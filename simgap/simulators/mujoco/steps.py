"""How long an engine's own steps are, and by which rule it integrates: accurate for a diagnosis, quick for a scan."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native, and unknown to type checkers.
import copy
from dataclasses import replace

import mujoco
import numpy as np
from jaxtyping import Float

from simgap.simulators.mujoco.engine import MujocoEngine

MOST_PARTS = 5
"""Most parts of a row in which commands may differ."""
FINER = 1.25
"""By how much more steps a row may be cut into, so that these make equal parts."""
LONGER = 1.01
"""By how much a step may be longer than is asked for: logs at 50 Hz have rows of 20.06 ms."""
COARSER = 2.0
"""By how much a step of fourth order may be longer than the model's own of first order;"""
REFINEMENTS = (1, 2, 4)
"""by how much shorter it is made where it must be, until"""
ALIKE = 1e-3
"""half a step gives the same next state [rad, rad/s, m, m/s]; and"""
STIFF = 8
"""by how much an implicit one is, of first order, where none of these is short enough."""
PROBES, MOTION = 64, 0.3
"""Rows in which that is tried, and standard deviation of their states and commands [rad, rad/s, ...]."""
_FOURTH, _IMPLICIT = (int(getattr(mujoco.mjtIntegrator, f"mjINT_{name}")) for name in ("RK4", "IMPLICITFAST"))


def accurate(engine: MujocoEngine) -> MujocoEngine:
    """With a step at whose end a row hardly depends on how long the step is: a robot's time goes on without steps.

    MuJoCo's own integrators are of first order: at 2 ms they lead by 1 ms, which recordings show as a sensor's delay.
    """
    steps, parts = cut(engine.time_step, COARSER * engine.source.spec.option.timestep)
    for refinement in REFINEMENTS:
        found = stepped(engine, steps * refinement, parts, _FOURTH)
        after, better = _probed(found), _probed(stepped(engine, 2 * steps * refinement, parts, _FOURTH))
        if np.isfinite(after).all() and np.nanmax(np.abs(after - better), initial=0.0) < ALIKE:
            return found
    return stepped(engine, STIFF * steps, parts, _IMPLICIT)


def quick(engine: MujocoEngine) -> MujocoEngine:
    """With steps as long as the model's own, and stable however stiff its servos are."""
    return stepped(engine, *cut(engine.time_step, engine.source.spec.option.timestep), _IMPLICIT)


def stepped(engine: MujocoEngine, steps: int, parts: int, integrator: int) -> MujocoEngine:
    """With so many steps in a row, and one of MuJoCo's integrators."""
    model = copy.copy(engine.model)
    model.opt.timestep, model.opt.integrator = engine.time_step / steps, integrator
    return replace(engine, model=model, steps=steps, parts=parts)


def cut(time_step: float, own: float) -> tuple[int, int]:
    """Steps in a row, none longer than `own` [s] but for a trifle, and the equal parts that they make."""
    least = max(int(np.ceil(time_step / (LONGER * own))), 1)
    ways = [(max(p for p in range(1, MOST_PARTS + 1) if n % p == 0), n) for n in range(least, int(least * FINER) + 1)]
    parts, steps = max(ways, key=lambda way: (way[0], -way[1]))
    return steps, parts


def _probed(engine: MujocoEngine) -> Float[np.ndarray, "n s"]:
    """The ends of some rows near the reference; the same rows whatever the steps are."""
    rng = np.random.default_rng(0)
    joints = engine.machine.joints
    state = rng.normal(0.0, MOTION, (PROBES, len(engine.schema.state)))
    state[:, : len(joints)] += [engine.machine.reference[j.qpos] for j in joints]
    command = np.repeat(rng.normal(0.0, MOTION, (PROBES, 1, len(engine.schema.command))), engine.parts, axis=1)
    none = np.zeros((PROBES, len(engine.terms))), np.zeros((PROBES, len(joints)))
    return engine.rows(engine.nominal, none[0], state, command, none[1])
