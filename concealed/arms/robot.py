"""The arm itself, in steps of half a millisecond: MuJoCo says how its links accelerate, and all that drives and brakes
them is computed here."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

from concealed.arms.design import Design, bare
from concealed.form import Array

MUJOCO: Any = mujoco  # its functions are native, and unknown to type checkers
FINE = 0.0005
"""Time step [s]."""
ROW = 40
"""Steps of a row, where its interval is what the time stamps say."""
SETTLING = 3000
"""Steps for which the first command is held before a session begins."""
BRISTLE = 2e-4
"""Angle by which a dry joint yields before it slides [rad]."""


class Gear(NamedTuple):
    """What lies between the motor of a joint and its link. play: angle that the motor turns through before it drags
    the link the other way [rad]. stiffness [N m/rad], damping [N m s/rad]: of what it drags with. share: of the joint's
    damping and of its servo's inertia that is on the link's side. seen: whether the encoder is at the motor, and not at
    the link."""

    joint: int
    play: float
    stiffness: float
    damping: float
    share: float
    seen: bool


@dataclass(frozen=True)
class Traits:
    """What an arm has beyond its design. friction [N m] and limit [N m]: of every servo [J]. load [kg]. lift: share of
    its weight that it carries by itself. late, lag [s]: of all commands. stiffness: of the servos, in the design's
    [J]. row: steps between rows."""

    friction: Array
    limit: Array
    stiffness: Array
    load: float = 0.0
    lift: float = 0.0
    late: float = 0.0
    lag: float = 0.0
    row: int = ROW
    gear: Gear | None = None


def plain(of: Design) -> Traits:
    """An arm that is as its maker says."""
    joints = len(of.joints)
    return Traits(np.zeros(joints), np.full(joints, np.inf), np.ones(joints))


class Session(NamedTuple):
    """Angles [T, J], speeds [T, J], and what the servos drove with in every row [T, J], without noise."""

    angle: Array
    speed: Array
    torque: Array


class Arm:
    """An arm that can be run. State: angles and speeds of the links, and those of a motor behind a gear."""

    def __init__(self, of: Design, traits: Traits) -> None:
        inertia = of.inertia.copy()
        if traits.gear is not None:
            inertia[traits.gear.joint] *= traits.gear.share
        self._of, self._traits = of, traits
        self._model = MUJOCO.MjModel.from_xml_string(bare(of, inertia, traits.load))
        self._data, self._still = MUJOCO.MjData(self._model), MUJOCO.MjData(self._model)
        self._stiffness = of.stiffness * traits.stiffness
        # Bristles swing as what they hold back lets them; half of critical damping calms them.
        self._hold = traits.friction / BRISTLE
        self._calm = np.sqrt(self._hold * of.inertia)

    def run(self, command: Array) -> Session:
        """A session [T, J] of commands, each held until the next row; at rest under the first one before."""
        traits, joints, rows = self._traits, command.shape[1], len(command)
        steps = SETTLING + (rows - 1) * traits.row + 1
        sent = np.concatenate([np.repeat(command[:1], SETTLING + round(traits.late / FINE), 0),
                               np.repeat(command, traits.row, 0)])  # fmt: skip
        share = 1.0 if traits.lag == 0 else -np.expm1(-FINE / traits.lag)
        y, bent, heard = self._rest(command[0]), np.zeros(joints), command[0].copy()
        found = Session(*(np.empty((rows, joints)) for _ in range(3)))
        for k in range(steps):
            heard += share * (sent[k] - heard)
            row, rest = divmod(k - SETTLING, traits.row)
            if row >= 0 and rest == 0:
                found.angle[row], found.speed[row] = self._seen(y, joints)
                found.torque[row] = self._drive(y, heard)
            middle = y + 0.5 * FINE * self._rate(y, heard, bent)
            y = y + FINE * self._rate(middle, heard, bent)
            bent = self._bend(bent, y[joints : 2 * joints])
        return found

    def _rest(self, angle: Array) -> Array:
        """Standing still at these angles; the motor behind a gear too."""
        gear = self._traits.gear
        motor = [] if gear is None else [angle[gear.joint], 0.0]
        return np.concatenate([angle, 0 * angle, motor])

    def _seen(self, y: Array, joints: int) -> tuple[Array, Array]:
        """What encoders see."""
        angle, speed, gear = y[:joints].copy(), y[joints : 2 * joints].copy(), self._traits.gear
        if gear is not None and gear.seen:
            angle[gear.joint], speed[gear.joint] = y[-2:]
        return angle, speed

    def _drive(self, y: Array, heard: Array) -> Array:
        """Torque of the servos, which feel the angles of their motors."""
        angle, gear = y[: len(heard)], self._traits.gear
        if gear is not None:
            angle = angle.copy()
            angle[gear.joint] = y[-2]
        return np.clip(self._stiffness * (heard - angle), -self._traits.limit, self._traits.limit)

    def _rate(self, y: Array, heard: Array, bent: Array) -> Array:
        """How the state changes."""
        joints, traits, data = len(heard), self._traits, self._data
        angle, speed = y[:joints], y[joints : 2 * joints]
        drive, drag = self._drive(y, heard), self._of.damping * speed
        slip = speed - np.abs(speed) * bent / BRISTLE
        torque = drive - drag - self._hold * bent - self._calm * slip
        motor: list[float] = []
        gear = traits.gear
        if gear is not None:
            j, (at, turns) = gear.joint, y[-2:]
            handed = _handed(gear, at - angle[j], turns - speed[j])
            own, inertia = ((1 - gear.share) * a[j] for a in (self._of.damping, self._of.inertia))
            motor = [turns, (drive[j] - own * turns - handed) / inertia]
            torque[j] = handed - gear.share * drag[j]
        if traits.lift:
            torque = torque + traits.lift * self.weight(angle)
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = angle, speed, torque
        MUJOCO.mj_forward(self._model, data)
        return np.concatenate([speed, data.qacc, motor])

    def weight(self, angle: Array) -> Array:
        """Torques [J] that hold the arm at these angles [J] against gravity, with what it carries."""
        still = self._still
        still.qpos[:] = angle
        MUJOCO.mj_fwdPosition(self._model, still)
        MUJOCO.mj_fwdVelocity(self._model, still)
        return still.qfrc_bias.copy()

    def _bend(self, bent: Array, speed: Array) -> Array:
        """Angles of the bristles after a step at these speeds: dragged along to where they slide [Dahl 1968]."""
        to = np.sign(speed) * BRISTLE
        return to + (bent - to) * np.exp(-np.abs(speed) * FINE / BRISTLE)


def _handed(gear: Gear, twist: float, turns: float) -> float:
    """Torque that a gear hands on to the link, by the motor's angle and speed against the link's."""
    beyond = twist - float(np.clip(twist, -gear.play / 2, gear.play / 2))
    return gear.stiffness * beyond + gear.damping * turns * (beyond != 0)
