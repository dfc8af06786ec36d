"""An arm as its maker knows it, drawn at random, and the MJCF that its user has of it."""

from typing import NamedTuple

import numpy as np

from concealed.form import Array

NAMES = ("base", "shoulder", "elbow", "roll", "wrist", "flange")
"""Joints from the floor to the tool; an arm of three has the first three. Servos have the names of their joints."""
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
JOINTS = (3, 6)
"""How many joints an arm may have."""
LENGTH = np.array([0.08, 0.28, 0.22, 0.07, 0.07, 0.05])
"""Of the links [m]; the first stands upright."""
MASS = np.array([1.0, 0.8, 0.5, 0.25, 0.2, 0.12])
"""Of the links [kg]."""
RADIUS = np.array([0.05, 0.03, 0.025, 0.025, 0.02, 0.02])
STIFFNESS = np.array([70.0, 80.0, 50.0, 30.0, 30.0, 25.0])
"""Of the servos [N m/rad]."""
RANGE = 2.6
"""Most that a joint may turn to either side [rad]."""
LOAD = 0.03
"""Radius of what is carried [m]."""


class Design(NamedTuple):
    """An arm of J joints, each array [J]: length [m], mass [kg] and radius [m] of the links; stiffness [N m/rad],
    damping [N m s/rad] and inertia [kg m^2] of the servos, as seen at the joints."""

    length: Array
    mass: Array
    radius: Array
    stiffness: Array
    damping: Array
    inertia: Array

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return NAMES[: len(self.length)]


def draw(joints: int, rng: np.random.Generator) -> Design:
    """An arm: sizes and masses within 20 %, stiffness and damping within about 30 % of what is usual."""
    some = lambda usual, by: usual[:joints] * np.exp(rng.uniform(-by, by, joints))  # noqa: E731
    length, mass, radius = some(LENGTH, 0.2), some(MASS, 0.2), some(RADIUS, 0.2)
    stiffness, inertia = some(STIFFNESS, 0.3), np.full(joints, rng.uniform(0.012, 0.025))
    # What a servo moves when the arm is stretched out: all behind it, at a distance.
    reach = np.array([length[max(j, 1) :].sum() for j in range(joints)])
    moved = np.array([mass[max(j, 1) :].sum() for j in range(joints)])
    along = np.array(AXES[:joints]) == "1 0 0"
    whole = inertia + np.where(along, moved * radius**2, 0.25 * moved * reach**2)
    damping = 2 * rng.uniform(0.5, 0.9, joints) * np.sqrt(stiffness * whole)
    return Design(*(np.round(a, 5) for a in (length, mass, radius, stiffness, damping, inertia)))


def model(of: Design) -> str:
    """The MJCF that the user has."""
    servos = "\n".join(f'    <position name="{name}" joint="{name}" kp="{kp:.5f}"/>'
                       for name, kp in zip(of.joints, of.stiffness, strict=True))  # fmt: skip
    joint = [f' range="-{RANGE} {RANGE}" damping="{c:.5f}" armature="{i:.5f}"'
             for c, i in zip(of.damping, of.inertia, strict=True)]  # fmt: skip
    site = '<site name="tool" pos="{tip}"/>'
    return _text(of, joint, site, f"  <actuator>\n{servos}\n  </actuator>\n")


def bare(of: Design, inertia: Array, load: float) -> str:
    """The links alone, with inertias [J] added at the joints and a ball of that mass [kg] held by the tool."""
    held = f'<body pos="{{tip}}"><geom type="sphere" size="{LOAD}" mass="{load}"/></body>' if load else ""
    return _text(of, [f' armature="{i:.9f}"' for i in inertia], held, "")


def _text(of: Design, joints: list[str], tool: str, rest: str) -> str:
    """Bodies within each other, each with a joint and a link; attributes of the joints, and what the last one holds."""
    opened, place = "", "0.00000 0 0.10000"
    for j, name in enumerate(of.joints):
        tip = f"0 0 {of.length[j]:.5f}" if j == 0 else f"{of.length[j]:.5f} 0 0"
        opened += (
            f'    <body name="{name}" pos="{place}">\n'
            f'      <joint name="{name}" axis="{AXES[j]}"{joints[j]}/>\n'
            f'      <geom type="capsule" fromto="0 0 0 {tip}" size="{of.radius[j]:.5f}" mass="{of.mass[j]:.5f}"/>\n'
        )
        place = tip
    return (
        '<mujoco model="arm">\n  <compiler angle="radian" autolimits="true"/>\n  <option timestep="0.002"/>\n'
        '  <default>\n    <geom contype="0" conaffinity="0"/>\n  </default>\n  <worldbody>\n'
        f"{opened}      {tool.format(tip=place)}\n    {'</body>' * len(of.joints)}\n  </worldbody>\n{rest}</mujoco>\n"
    )
