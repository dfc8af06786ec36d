"""Open-loop replays of recordings, and a scan of servo stiffness that detects a model that is far off."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from simgap.simulators.mujoco.engine import MujocoEngine
from simgap.simulators.mujoco.steps import accurate, quick
from simgap.types import Recording

COARSE = tuple(2.0**k for k in range(-9, 5))
"""Factors on the model's stiffness that are tried first, from 1/512 to 16."""
FINE = tuple(2.0 ** (k / 6) for k in (-4, -3, -2, -1, 1, 2, 3, 4))
"""Factors on the best of these, tried next."""
MOST_ROWS = 6000
"""Rows that a scan replays with each factor: more rows do not change the best one."""
FAR = 3.0
"""A stiffness that is wrong by more than this factor means a wrong model, not a parameter to refine."""
GAIN = 0.9
"""The best factor must lower the error at least to this share."""


@dataclass(frozen=True)
class Scan:
    """Replay errors with all servo stiffnesses multiplied by some factors.

    shares: the factors, ascending. errors: RMS of each joint's position [rad, m]. best: the factor with the smallest
    error, each joint's relative to its motion. far: whether the model is far off. says: what that means, in words.
    """

    shares: Float[np.ndarray, " n"]
    errors: Float[np.ndarray, "n j"]
    best: float
    far: bool
    says: str


def replay(
    engine: MujocoEngine,
    recordings: Sequence[Recording],
    phi: Float[np.ndarray, " p"] | None = None,
    terms: Float[np.ndarray, " k"] | None = None,
) -> Float[np.ndarray, " j"]:
    """RMS of each joint's position error [rad, m] when whole sessions are replayed from their first state.

    Velocities that are not recorded start at zero. The error is infinite where the engine diverges.
    """
    phi = engine.nominal if phi is None else phi
    terms = np.zeros(len(engine.terms)) if terms is None else terms
    joints = len(engine.machine.joints)
    squares, rows = np.zeros(joints), 0
    for recording in recordings:
        path = engine.path(phi, terms, start(engine, recording), recording.command)
        with np.errstate(invalid="ignore"):
            squares += ((path[:, :joints] - recording.state[:, :joints]) ** 2).sum(0)
        rows += len(path)
    return np.sqrt(np.nan_to_num(squares, nan=np.inf) / max(rows, 1))


def start(engine: MujocoEngine, recording: Recording) -> Float[np.ndarray, " s"]:
    """The first state: at rest where no velocity is recorded, with servos that have their own state settled."""
    first = np.zeros(len(engine.schema.state))
    first[: recording.state.shape[1]] = recording.state[0]
    slow = [(i, a) for i, a in enumerate(engine.machine.actuators) if a.act is not None]
    for k, (i, actuator) in enumerate(slow, len(first) - len(slow)):
        if actuator.kind == "velocity" and actuator.joint is not None:  # its state is the position that it holds
            first[k] = first[engine.machine.joints.index(actuator.joint)]
        else:
            first[k] = recording.command[0, i]
    return first


def scan(engine: MujocoEngine, recordings: Sequence[Recording]) -> Scan | None:
    """Try factors on the stiffness of all position servos together; None where the model has no such servo."""
    servos = _servos(engine)
    if not servos.any():
        return None
    sessions, coarse = _subset(recordings), quick(engine)
    joints = len(engine.machine.joints)
    motion = np.maximum(np.concatenate([r.state[:, :joints] for r in sessions]).std(0), 1e-6)
    errors: dict[float, Float[np.ndarray, " j"]] = {}

    def cost(share: float) -> float:
        if share not in errors:
            errors[share] = replay(coarse, sessions, engine.nominal + np.log(share) * servos)
        return float(((errors[share] / motion) ** 2).mean())

    best = min(COARSE, key=cost)
    best = min((best, *(best * step for step in FINE)), key=cost)
    far = max(best, 1 / best) > FAR and cost(best) < GAIN**2 * cost(1.0)
    shares = sorted(errors)
    return Scan(np.array(shares), np.array([errors[s] for s in shares]), best, far, _words(best) if far else "")


def rescaled(engine: MujocoEngine, share: float) -> MujocoEngine:
    """The engine with all servo stiffnesses multiplied by `share` in its nominal parameters; ranges move with them."""
    return accurate(replace(engine, nominal=engine.nominal + np.log(share) * _servos(engine)))


def rescaling(engine: MujocoEngine) -> str:
    """What `rescaled` did to an engine, in words; empty where it starts from the model as it is."""
    shares = np.exp(engine.nominal[_servos(engine)])
    if not shares.size or np.all(shares == 1):
        return ""
    share = float(shares.max())
    how = f"divided by {_rounded(1 / share)}" if share < 1 else f"times {_rounded(share)}"
    return f"{_words(share)} The diagnosis takes the model with kp {how} as the nominal simulator."


def _servos(engine: MujocoEngine) -> Bool[np.ndarray, " p"]:
    """Which parameters are stiffnesses of position servos."""
    return np.array([s.name.startswith("kp ") for s in engine.scaled], bool)


def _subset(recordings: Sequence[Recording]) -> list[Recording]:
    """Whole sessions at regular intervals, with about `MOST_ROWS` rows."""
    total = sum(len(r.time_s) for r in recordings)
    every = max(1, round(total / MOST_ROWS))
    return list(recordings[::every])


def _words(share: float) -> str:
    factor, which = (1 / share, "stiff") if share < 1 else (share, "soft")
    return f"The model's position servos are about {_rounded(factor)} times too {which} (kp)."


def _rounded(factor: float) -> str:
    """Two significant digits, never as a power of ten."""
    return f"{float(f'{factor:.2g}'):g}"
