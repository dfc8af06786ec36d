"""Length of an engine's own steps and its integrator: accurate for a diagnosis, quick for a scan."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
import copy
from dataclasses import replace

import mujoco
import numpy as np
from jaxtyping import Float

from simgap.simulators.mujoco.engine import MujocoEngine

MOST_PARTS = 5
"""Maximum number of parts of a row in which commands may differ."""
FINER = 1.25
"""A row may have up to this factor more steps, so that they make equal parts."""
LONGER = 1.01
"""A step may be longer than requested by this factor: logs at 50 Hz have rows of 20.06 ms."""
COARSER = 2.0
"""A fourth-order step may be longer by this factor than the model's own first-order step."""
REFINEMENTS = (1, 2, 4)
"""Factors by which the fourth-order step is shortened, until it is accurate."""
ALIKE = 1e-3
"""A step is accurate if half the step changes next states by less than this [rad, rad/s, m, m/s] ..."""
MOST = 0.95
"""... in this share of the rows: where friction stops a joint within a row, no step is."""
ROUGHLY = 1e-2
"""A step is good enough for derivatives if the accurate step changes next states by less than this, likewise."""
STIFF = 8
"""Factor by which the implicit first-order step is shortened, where no fourth-order one is accurate."""
PROBES, MOTION = 64, 0.3
"""Rows for the accuracy test, and standard deviation of their states and commands [rad, rad/s, ...]."""
_FOURTH, _IMPLICIT = (int(getattr(mujoco.mjtIntegrator, f"mjINT_{name}")) for name in ("RK4", "IMPLICITFAST"))


def accurate(engine: MujocoEngine) -> MujocoEngine:
    """The engine with steps so short that their length hardly matters: a robot's time is continuous.

    MuJoCo's default integrators are of first order. At 2 ms they lead by 1 ms, which would look like a sensor delay.
    """
    steps, parts = cut(engine.time_step, COARSER * engine.source.spec.option.timestep)
    candidates = [stepped(engine, steps * refinement, parts, _FOURTH) for refinement in REFINEMENTS]
    ends: list[Float[np.ndarray, "n s"]] = []
    for candidate in candidates:
        finer = _probed(stepped(engine, 2 * candidate.steps, parts, _FOURTH))
        ends.append(_probed(candidate))
        if _alike(ends[-1], finer, ALIKE):
            rough = next(c for c, end in zip(candidates, ends, strict=False) if _alike(end, finer, ROUGHLY))
            return replace(candidate, rough_steps=rough.steps)
    return stepped(engine, STIFF * steps, parts, _IMPLICIT)


def _alike(ends: Float[np.ndarray, "n s"], finer: Float[np.ndarray, "n s"], most: float) -> bool:
    """Whether all next states are finite, and differ by less than `most` in the share `MOST` of the rows."""
    return bool(np.isfinite(ends).all() and np.quantile(np.abs(ends - finer).max(1), MOST) < most)


def quick(engine: MujocoEngine) -> MujocoEngine:
    """The engine with steps as long as the model's own, and stable however stiff its servos are."""
    return stepped(engine, *cut(engine.time_step, engine.source.spec.option.timestep), _IMPLICIT)


def stepped(engine: MujocoEngine, steps: int, parts: int, integrator: int) -> MujocoEngine:
    """The engine with this number of steps per row, and one of MuJoCo's integrators."""
    model = copy.copy(engine.model)
    model.opt.timestep, model.opt.integrator = engine.time_step / steps, integrator
    return replace(engine, model=model, steps=steps, parts=parts, rough_steps=steps)


def cut(time_step: float, own: float) -> tuple[int, int]:
    """Steps per row, longer than `own` [s] at most by `LONGER`, and the number of equal parts that they make."""
    least = max(int(np.ceil(time_step / (LONGER * own))), 1)
    ways = [(max(p for p in range(1, MOST_PARTS + 1) if n % p == 0), n) for n in range(least, int(least * FINER) + 1)]
    parts, steps = max(ways, key=lambda way: (way[0], -way[1]))
    return steps, parts


def _probed(engine: MujocoEngine) -> Float[np.ndarray, "n s"]:
    """Next states of random rows near the reference; the rows are the same for all step lengths.

    A body that floats stays where the reference has it: elsewhere it might stand in the floor.
    """
    rng = np.random.default_rng(0)
    joints = engine.machine.joints
    state = rng.normal(0.0, MOTION, (PROBES, len(engine.schema.state)))
    state[:, : len(joints)] *= [not j.floating for j in joints]
    state[:, : len(joints)] += [engine.machine.reference[j.qpos] for j in joints]
    command = np.repeat(rng.normal(0.0, MOTION, (PROBES, 1, len(engine.schema.command))), engine.parts, axis=1)
    zeros = np.zeros((PROBES, len(engine.terms))), np.zeros((PROBES, len(joints)))
    return engine.rows(engine.nominal, zeros[0], state, command, zeros[1])
