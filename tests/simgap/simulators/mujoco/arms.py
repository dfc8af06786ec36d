"""Small models that the tests write, as text, and what can be switched on in them."""

import numpy as np

from simgap.simulators.mujoco import MujocoEngine

ARM = """
<mujoco model="arm">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002"/>
  <worldbody>
    <body name="base">
      <geom type="box" size=".05 .05 .02" mass="1" contype="0" conaffinity="0"/>
      <body name="upper" pos="0 0 .05">
        <joint name="pan" axis="0 0 1" range="-2 2" damping=".2" {pan}/>
        <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".5" contype="0" conaffinity="0"/>
        <body name="fore" pos=".2 0 0">
          <joint name="lift" axis="0 1 0" range="-2 2" damping=".2" armature=".01" {lift}/>
          <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".4" contype="0" conaffinity="0"/>
          <body name="hand" pos=".2 0 0" {hand}>
            <joint name="reach" type="slide" axis="1 0 0" range="-.1 .1" damping="4"/>
            <geom type="capsule" fromto="0 0 0 .1 0 0" size=".02" mass=".2" contype="0" conaffinity="0"/>
            {inside}
            <site name="tool" pos=".12 0 0"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="pan" joint="pan" kp="12" {servo}/>
    <position name="lift" joint="lift" kp="20" kv=".5"/>
    <motor name="push" joint="reach"/>
  </actuator>
  {end}
</mujoco>
"""
NOTHING = {"pan": "", "lift": "", "hand": "", "inside": "", "servo": "", "end": ""}


def arm(**parts: str) -> str:
    """The arm of three joints with attributes or elements added in places."""
    return ARM.format(**{**NOTHING, **parts})


URDF = """
<robot name="two">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz=".1 0 0"/><mass value=".5"/>
    <inertia ixx="1e-3" iyy="2e-3" izz="2e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz=".1 0 0"/><mass value=".3"/>
    <inertia ixx="1e-3" iyy="2e-3" izz="2e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="30" velocity="5"/><dynamics damping=".1"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz=".2 0 0"/>
    <axis xyz="0 1 0"/></joint>
</robot>
"""


def starts(engine: MujocoEngine, which: int = 0) -> np.ndarray:
    """A start of every term that a model file can hold: the time between rows is none."""
    return np.array([0.0 if t.effect == "sampling_interval" else t.starts[which] for t in engine.terms])
