"""What an arm may have that its model lacks, in amounts drawn at random, and the words that are right for it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from concealed.arms.design import AXES, Design
from concealed.arms.robot import FINE, ROW, Arm, Gear, Traits, plain
from concealed.effect import constants_of, of_cause
from concealed.form import Array


class Drawn(NamedTuple):
    """What became of a cause: the arm's traits, joints that it acts on (all, if none are named), its constant as name,
    value and unit, and a parameter that is wrong in the user's model, with its true value."""

    traits: Traits
    joints: tuple[str, ...] = ()
    constant: tuple[str, float, str] | None = None
    wrong: tuple[str, float] | None = None


Draw = Callable[[Design, Array, np.random.Generator], Drawn]
"""For a design and the commands [S, T, J] that it will be sent."""


class Cause(NamedTuple):
    """A cause; the words that are right for it (none: a wrong parameter), and why."""

    draw: Draw
    kind: str
    accept: tuple[str, ...]
    why: str


def _one_dry(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
    j, loss = int(rng.integers(len(of.joints))), _between(rng, 0.15, 0.4)
    friction = np.where(np.arange(len(of.joints)) == j, loss, 0.0)
    return Drawn(replace(plain(of), friction=friction), (of.joints[j],), ("loss", loss, "N m"))


def _all_dry(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
    loss = _between(rng, 0.15, 0.4)
    return Drawn(replace(plain(of), friction=np.full(len(of.joints), loss)), (), ("loss", loss, "N m"))


def _loaded(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
    load = _between(rng, 0.2, 0.5)
    return Drawn(replace(plain(of), load=load), (), ("mass", load, "kg"))


def _lifted(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
    lift = _between(rng, 0.3, 0.7)
    return Drawn(replace(plain(of), lift=lift), (), ("share", lift, "-"))


def _late(seconds: float) -> Draw:
    def draw(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
        return Drawn(replace(plain(of), late=seconds), (), ("delay", seconds, "s"))

    return draw


def _slow(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
    lag = _between(rng, 0.03, 0.08)
    return Drawn(replace(plain(of), lag=lag), (), ("time constant", lag, "s"))


def _weak(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
    """One of the first three servos gives no more than it needs in nine rows of ten or more, but holds the arm."""
    arm, share = Arm(of, plain(of)), rng.uniform(0.9, 0.95)
    needed = np.quantile(np.abs(np.concatenate([arm.run(session).torque for session in command])), share, axis=0)
    held = np.max([np.abs(arm.weight(angle)) for session in command for angle in session[::5]], axis=0)
    j = int(rng.choice([j for j in range(3) if 1.2 * held[j] <= needed[j]]))
    limit = round(float(needed[j]), 4)
    limits = np.where(np.arange(len(of.joints)) == j, limit, np.inf)
    return Drawn(replace(plain(of), limit=limits), (of.joints[j],), ("limit", limit, "N m"))


def _soft_or_stiff(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
    """The user's stiffness of one servo is wrong, by a fifth to a third."""
    j = int(rng.integers(len(of.joints)))
    share = np.exp(rng.uniform(0.2, 0.4) * rng.choice([-1, 1]))
    stiffness = np.where(np.arange(len(of.joints)) == j, share, 1.0)
    wrong = (f"kp {of.joints[j]}", float(share * of.stiffness[j]))
    return Drawn(replace(plain(of), stiffness=stiffness), (of.joints[j],), None, wrong)


def _other_clock(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
    row = ROW + int(rng.choice([-5, -4, -3, -2, 2, 3, 4, 5]))
    return Drawn(replace(plain(of), row=row), (), ("interval", row * FINE, "s"))


def _worn(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
    """At a joint that gravity does not press against one end of the gap. The encoder is at the link, whose side has
    most of the damping; the teeth are much stiffer than the servo."""
    free = [j for j in range(len(of.joints)) if AXES[j] != "0 1 0"]
    j, gap = int(rng.choice(free)), _between(rng, 0.015, 0.04)
    stiffness = 40 * of.stiffness[j]
    gear = Gear(j, gap, stiffness, 0.6 * np.sqrt(stiffness * of.inertia[j]), 0.6, False)
    return Drawn(replace(plain(of), gear=gear), (of.joints[j],), ("gap", gap, "rad"))


def _springy(of: Design, command: Array, rng: np.random.Generator) -> Drawn:
    """One of the first three joints. The encoder is at the motor, which shows how the link swings by giving way."""
    j = int(rng.integers(3))
    stiffness = of.stiffness[j] * rng.uniform(1.5, 4.0)
    gear = Gear(j, 0.0, stiffness, 0.1 * np.sqrt(stiffness * of.inertia[j]), 0.0, True)
    return Drawn(replace(plain(of), gear=gear), (of.joints[j],), ("stiffness", float(stiffness), "N m/rad"))


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """A size between two, evenly in its logarithm."""
    return round(float(np.exp(rng.uniform(np.log(low), np.log(high)))), 4)


_LATE = Cause(_late(0.03), "single", ("delay",), "commands wait in a queue before any servo follows them")
CAUSES = {
    "friction at a joint": Cause(_one_dry, "single", ("coulomb_friction",),
                                 "bristles bend by a fifth of a milliradian, then slide under a constant torque"),
    "friction at all joints": Cause(_all_dry, "single", ("coulomb_friction",), "equal servos, equally dry"),
    "payload": Cause(_loaded, "single", ("payload",), "a ball is held by the tool"),
    "gravity compensation": Cause(_lifted, "single", ("joint_gravity",), "the arm carries a share of its own weight"),
    "delay of 30 ms": _LATE,
    "delay of 40 ms": _LATE._replace(draw=_late(0.04)),
    "lag": Cause(_slow, "single", ("lag",), "a filter of first order lies before all servos"),
    "force limit": Cause(_weak, "single", ("force_limit",), "a servo's torque is clipped"),
    "wrong kp": Cause(_soft_or_stiff, "parameters", (), "the user's model has another stiffness of a servo"),
    "wrong time step": Cause(_other_clock, "single", ("sampling_interval",), "a row lasts longer or shorter than said"),
    "backlash": Cause(_worn, "single", ("link_backlash", "backlash"),
                      "the motor turns through a gap before it drags the link, where the encoder is"),
    "elastic joint": Cause(_springy, "single", ("elastic_joint",),
                           "a spring gives way between the motor, where the encoder is, and the link"),
}  # fmt: skip
"""By what a person would say."""


def effects_of(name: str, drawn: Drawn) -> list[dict[str, Any]]:
    """What the key says of a cause: nothing of a wrong parameter, which is no effect."""
    cause = CAUSES[name]
    if cause.kind == "parameters":
        return []
    channels = [f"cmd_{joint}" for joint in drawn.joints]
    return [of_cause(name, cause.accept, cause.why, channels, constants_of(drawn.constant))]
