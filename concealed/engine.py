"""The robot once more, in a physics engine: a body driven over the floor by motors with limits, an arm with joints.

Nothing of it is written as an effect: causes are switched on in the engine (a weight in the hand, ice, a ramp, tired
motors, dry joints, a late link, a push), and the key says which words are right for what they do, and why.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from concealed.effect import of_cause
from concealed.form import Array, Size
from concealed.operator import Habits, Person
from concealed.plain import TIME_STEP
from concealed.strength import of_change

MUJOCO: Any = mujoco  # its functions are native, and unknown to type checkers
STEPS = 20
"""Of the engine within a row."""
REST = np.array([0.0, -0.9, 1.7])
"""Joint angles at the start [rad]: shoulder yaw, shoulder pitch, elbow."""
SESSIONS, ROWS = 8, 321
NOISE = np.array([2e-3, 2e-3, 3e-3, 1e-2, 1e-2, 1.5e-2, 2e-3, 2e-3, 2e-3, 1e-2, 1e-2, 1e-2])
"""Standard deviations of what is measured, in the units of the state."""

_MODEL = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{step}" gravity="{gx} {gy} -9.81" integrator="implicitfast"/>
  <worldbody>
    <body name="base" pos="0 0 0.5">
      <joint name="x" type="slide" axis="1 0 0" damping="4"/>
      <joint name="y" type="slide" axis="0 1 0" damping="4"/>
      <joint name="yaw" type="hinge" axis="0 0 1" damping="1"/>
      <geom type="box" size="0.45 0.2 0.12" mass="30" contype="0" conaffinity="0"/>
      <body name="shoulder" pos="0.25 0 0.15" gravcomp="1">
        <joint name="turn" type="hinge" axis="0 0 1" range="-1.6 1.6" damping="0.5" frictionloss="{friction}"/>
        <geom type="sphere" size="0.06" mass="1.5" contype="0" conaffinity="0"/>
        <body name="upper" gravcomp="{lift}">
          <joint name="raise" type="hinge" axis="0 1 0" range="-2.9 1.2" damping="0.5" frictionloss="{friction}"/>
          <geom type="capsule" fromto="0 0 0 0.6 0 0" size="0.04" mass="2.5" contype="0" conaffinity="0"/>
          <body name="fore" pos="0.6 0 0" gravcomp="{lift}">
            <joint name="bend" type="hinge" axis="0 1 0" range="0.1 2.8" damping="0.3" frictionloss="{friction}"/>
            <geom type="capsule" fromto="0 0 0 0.55 0 0" size="0.03" mass="1.5" contype="0" conaffinity="0"/>
            <site name="hand" pos="0.6 0 0"/>
            <body name="load" pos="0.6 0 0">
              <geom type="sphere" size="0.03" mass="{load}" contype="0" conaffinity="0"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <velocity joint="x" kv="400" forcerange="-{grip} {grip}"/>
    <velocity joint="y" kv="400" forcerange="-{grip} {grip}"/>
    <velocity joint="yaw" kv="40" forcerange="-{turn} {turn}"/>
    <velocity joint="turn" kv="{motor}" forcerange="-{torque} {torque}"/>
    <velocity joint="raise" kv="{motor}" forcerange="-{torque} {torque}"/>
    <velocity joint="bend" kv="{motor}" forcerange="-{torque} {torque}"/>
  </actuator>
</mujoco>
"""


@dataclass(frozen=True)
class Machine:
    """What a cause changes. load [kg]; grip [N] and turn [N m]: most that the feet bear; gx, gy: the floor's tilt as
    gravity along it [m/s²]; motor [N m s/rad], torque [N m]: of the arm's motors; friction [N m]: in its joints; late
    [rows]; push [N], in one session."""

    load: float = 0.02
    grip: float = 300.0
    turn: float = 60.0
    gx: float = 0.0
    gy: float = 0.0
    motor: float = 60.0
    torque: float = 80.0
    friction: float = 0.0
    late: float = 0.0
    push: float = 0.0

    def model(self) -> Any:
        """The engine's model."""
        values = {**self.__dict__, "step": TIME_STEP / STEPS, "lift": 1}
        return MUJOCO.MjModel.from_xml_string(_MODEL.format(**values))


class Cause(NamedTuple):
    """Something that happens to a machine; small and large values; the words that are right for it, and why."""

    change: str
    values: tuple[float, float]
    accept: tuple[str, ...]
    why: str


CAUSES = {
    "payload on the hand": Cause(
        "load", (1.0, 3.0), ("payload", "gravity_sag"),
        "a weight pulls the hand down against motors that yield: it sinks, the more the further it reaches",
    ),
    "slippery floor": Cause(
        "grip", (25.0, 12.0), ("rate_limit", "slip", "lag"),
        "feet that bear less force limit the base's acceleration; what is too fast for them slips",
    ),
    "tilted floor": Cause(
        "gx", (0.5, 1.5), ("slope", "external_push"),
        "gravity along the floor pulls in a fixed direction of the world, all the time",
    ),
    "weak motors": Cause(
        "motor", (8.0, 4.0), ("lag", "gain", "viscous_drag", "payload"),
        "motors that yield answer later and follow less of the command",
    ),
    "joint friction": Cause(
        "friction", (3.0, 8.0), ("coulomb_friction", "deadband"),
        "dry joints resist with a constant torque: small commands stick",
    ),
    "late commands": Cause(
        "late", (1.0, 2.0), ("delay", "lag"), "commands wait before they are sent on; by whole rows they are a delay"
    ),
    "a push": Cause(
        "push", (60.0, 150.0), ("external_push",), "a force on the body during two seconds of one session"
    ),
}  # fmt: skip
"""By what a person would say."""


class Set(NamedTuple):
    """Sessions measured [S, T, 12] and commanded [S, T, 6]."""

    measured: Array
    command: Array


def changed(cause: str | None, large: bool) -> Machine:
    """The machine after a cause; as it was, without one."""
    machine = Machine()
    if cause is None:
        return machine
    value = CAUSES[cause].values[large]
    more = {"turn": machine.turn * value / machine.grip} if CAUSES[cause].change == "grip" else {}
    return replace(machine, **{CAUSES[cause].change: value}, **more)


class Case(NamedTuple):
    """Recordings from before and after a cause was switched on, and the key."""

    before: Set
    after: Set
    key: dict[str, Any]


def conceal(cause: str | None, large: bool, rng: np.random.Generator) -> Case:
    """A machine before and after a cause; without one, nothing changed."""
    before, after = record(Machine(), rng), record(changed(cause, large), rng)
    what = CAUSES.get(cause or "")
    effects = []
    if what is not None:
        effects = [of_cause(str(cause), what.accept, what.why)]
    key = {
        "kind": "null" if what is None else "engine", "effects": effects, "when": None, "target": 0.0,
        "strength": of_change(before.measured, before.command, after.measured, after.command),
        "verdicts": ["nothing", "parameters_only"] if what is None else ["missing_physics"],
        "recipe": {"size": "usual", "poor": False, "level": 1.0, "outliers": False, "wild": False, "large": large},
    }  # fmt: skip
    return Case(before, after, key)


def record(machine: Machine, rng: np.random.Generator) -> Set:
    """Sessions of a machine, teleoperated as the other robots are."""
    model = machine.model()
    # Of sessions that are held out nothing could be learnt: every fourth.
    pushed = int(rng.choice([s for s in range(SESSIONS) if s % 4 != 3]))
    sets = [_session(model, machine, s == pushed, rng) for s in range(SESSIONS)]
    return Set(np.stack([s.measured for s in sets]), np.stack([s.command for s in sets]))


def _session(model: Any, machine: Machine, pushed: bool, rng: np.random.Generator) -> Set:
    data = MUJOCO.MjData(model)
    data.qpos[2], data.qpos[3:6] = rng.uniform(-np.pi, np.pi), REST
    data.qpos[:2] = rng.uniform(-1, 1, 2)
    MUJOCO.mj_forward(model, data)
    person = Person(Habits(1.0, np.ones(6)), Size(1, 1, ROWS), rng)
    start, to = rng.uniform(0.3, 0.6) * ROWS, rng.uniform(0, 2 * np.pi)
    measured, command = np.empty((ROWS, 12)), np.empty((ROWS, 6))
    link = [np.zeros(6)] * (round(machine.late) + 1)
    for t in range(ROWS):
        y = _state(model, data) + NOISE * rng.normal(size=12)
        y[2] = np.angle(np.exp(1j * y[2]))
        measured[t], command[t] = y, person(t, y[None])[0]
        link = [command[t], *link[:-1]]
        pushes = pushed and 0 <= t - start < 2 / TIME_STEP
        data.xfrc_applied[1, :2] = machine.push * pushes * np.array([np.cos(to), np.sin(to)])
        world = link[-1].copy()
        c, s = np.cos(data.qpos[2]), np.sin(data.qpos[2])
        world[[0, 3]], world[[1, 4]] = c * world[[0, 3]] - s * world[[1, 4]], s * world[[0, 3]] + c * world[[1, 4]]
        data.ctrl[:3] = world[:3]
        for _ in range(STEPS):
            data.ctrl[3:] = _joints(model, data, world[3:])
            MUJOCO.mj_step(model, data)
    return Set(measured, command)


def _state(model: Any, data: Any) -> Array:
    jacobian = np.zeros((3, model.nv))
    MUJOCO.mj_jacSite(model, data, jacobian, None, 0)
    return np.concatenate([data.qpos[:3], data.qvel[:3], data.site_xpos[0], jacobian @ data.qvel])


def _joints(model: Any, data: Any, hand: Array) -> Array:
    """Joint speeds that move the hand as commanded beyond the base's motion: damped least squares."""
    jacobian = np.zeros((3, model.nv))
    MUJOCO.mj_jacSite(model, data, jacobian, None, 0)
    J = jacobian[:, 3:6]
    return np.clip(J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(3), hand), -4, 4)
