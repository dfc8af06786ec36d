"""Open-loop replays of recordings, and a scan of servo stiffness that detects a model that is far off."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from simgap.diagnosis.report.names import number
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
APART = tuple(2.0 ** (k / 2) for k in range(-6, 3))
"""Factors on the stiffness that fits all servos best, which are tried for each servo of a model that is far off."""
DAMPINGS = (1.0, 0.5, 0.25, 0.125)
"""Factors on the damping tried with each of these: a servo with too large a kp often has too large a kv."""


@dataclass(frozen=True)
class Scan:
    """Replay errors with all servo stiffnesses multiplied by some factors.

    shares: the factors, ascending. errors: RMS of each joint's position [rad, m]. best: the factor with the smallest
    error, each joint's relative to its motion. far: whether the model is far off. start: factors on single parameters
    from which a model that is far off should start. says: what that means, in words.
    """

    shares: Float[np.ndarray, " n"]
    errors: Float[np.ndarray, "n j"]
    best: float
    far: bool
    start: dict[str, float]
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
            squares += (_missed(engine, path, recording) ** 2).sum(0)
        rows += len(path)
    return np.sqrt(np.nan_to_num(squares, nan=np.inf) / max(rows, 1))


def _missed(engine: MujocoEngine, path: Float[np.ndarray, "T s"], recording: Recording) -> Float[np.ndarray, "T j"]:
    """Errors of the joints' positions; angles up to whole turns."""
    joints = engine.machine.joints
    e = path[:, : len(joints)] - recording.state[:, : len(joints)]
    turning = [j.kind == "angle" for j in joints]
    e[:, turning] -= 2 * np.pi * np.round(e[:, turning] / (2 * np.pi))
    return e


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
    start = _each(engine, sessions, best, motion) if far else {}
    shares, apart = sorted(errors), [share for name, share in start.items() if _is_kp(name)]
    return Scan(np.array(shares), np.array([errors[s] for s in shares]), best, far, start, _words(apart))


def _each(
    engine: MujocoEngine, sessions: Sequence[Recording], common: float, motion: Float[np.ndarray, " j"]
) -> dict[str, float]:
    """Factors on the stiffness and the damping of each servo, with which its own joint is replayed best.

    All servos are moved together, since a servo hardly moves other joints than its own. One departs from the common
    factor only if that lowers its joint's error to `GAIN`, and all only if they lower the error of all joints.
    """
    coarse, servos = quick(engine), _servos(engine)
    damped = np.array([s.name.startswith("damping ") for s in engine.scaled], bool)

    def errors(shares: Float[np.ndarray, " p"]) -> Float[np.ndarray, " j"]:
        return replay(coarse, sessions, engine.nominal + np.log(shares))

    pairs = [(common * stiffness, damping) for stiffness in APART for damping in DAMPINGS]
    found = np.array([errors(np.where(servos, s, np.where(damped, d, 1.0))) for s, d in pairs])
    same = np.where(servos, common, 1.0)
    before = errors(same)
    names = [s.name for s in engine.scaled]
    shares = np.array(same)
    for actuator in engine.machine.actuators:
        if actuator.joint is None or (kp := f"kp {actuator.name}") not in names:
            continue
        joint = engine.machine.joints.index(actuator.joint)
        best = int(found[:, joint].argmin())
        if found[best, joint] < GAIN * before[joint]:
            shares[names.index(kp)], damping = pairs[best]
            if (name := f"damping {actuator.joint.name}") in names:
                shares[names.index(name)] = damping
    if ((errors(shares) / motion) ** 2).mean() > ((before / motion) ** 2).mean():
        shares = same
    return {name: float(share) for name, share in zip(names, shares, strict=True) if share != 1}


def rescaled(engine: MujocoEngine, shares: Mapping[str, float]) -> MujocoEngine:
    """The engine with some parameters multiplied by factors in its nominal values; their ranges move with them."""
    factors = np.array([shares.get(s.name, 1.0) for s in engine.scaled])
    return accurate(replace(engine, nominal=engine.nominal + np.log(factors), given=engine))


def rescaling(engine: MujocoEngine) -> str:
    """What `rescaled` did to the servos of an engine, in words; empty where it starts from the model as it is."""
    servos = [(s, float(np.exp(at))) for s, at in zip(engine.scaled, engine.nominal, strict=True) if _is_kp(s.name)]
    shares = [share for _, share in servos]
    if all(share == 1 for share in shares):
        return ""
    if max(shares) == min(shares):
        how = f"divided by {number(1 / shares[0], 2)}" if shares[0] < 1 else f"times {number(shares[0], 2)}"
        return f"{_words(shares)} The diagnosis takes the model with kp {how} as the nominal simulator."
    values = [f"{s.name} {number(share * s.of)} {s.unit} ({number(s.of)} in the model)" for s, share in servos]
    return f"{_words(shares)} The diagnosis starts from {', '.join(values)}, and from dampings that fit with these."


def _servos(engine: MujocoEngine) -> Bool[np.ndarray, " p"]:
    """Which parameters are stiffnesses of position servos."""
    return np.array([_is_kp(s.name) for s in engine.scaled], bool)


def _is_kp(parameter: str) -> bool:
    return parameter.startswith("kp ")


def _subset(recordings: Sequence[Recording]) -> list[Recording]:
    """Whole sessions at regular intervals, with about `MOST_ROWS` rows."""
    total = sum(len(r.time_s) for r in recordings)
    every = max(1, round(total / MOST_ROWS))
    return list(recordings[::every])


def _words(shares: Sequence[float]) -> str:
    """How far off the stiffness of the servos is, whose true shares of the model's these are; empty for none."""
    if not shares:
        return ""
    low, high = min(shares), max(shares)
    if low < 1 < high:
        return "The stiffness of the model's position servos (kp) is far off."
    ends, which = ((1 / high, 1 / low), "stiff") if high <= 1 else ((low, high), "soft")
    factor = f"about {number(ends[0], 2)}" if low == high else f"{number(ends[0], 2)} to {number(ends[1], 2)}"
    return f"The model's position servos are {factor} times too {which} (kp)."
