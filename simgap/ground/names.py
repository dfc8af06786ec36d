"""Which effects name a family of the training ground rightly."""

from simgap.ground.families import FAMILIES
from simgap.ground.family import ALL, HELD, STAYING

EQUIVALENT = {
    **{(machine, "bias"): "sensor_bias" for machine in HELD},
    **{(machine, "hardening"): "nonlinear_spring" for machine in STAYING},
    **{(machine, "bristles"): "hysteresis" for machine in STAYING},
    **{(machine, family): "stribeck_friction" for machine in STAYING for family in ("friction", "stribeck")},
    **{(machine, "under_load"): "load_friction" for machine in STAYING if machine not in (*HELD, "trolley")},
    **{(machine, "gain"): "sensor_scale" for machine in ("servo", "servo_positions")},
    **{(machine, "sensor_scale"): "sampling_interval" for machine in ("cart", "servo", "pendulum")},
    **{(machine, family): "sensor_delay" for machine in ALL for family in ("delay", "dispersion")},
    **{(machine, "leak"): "cross_axis_coupling" for machine in ("base", "wheels")},
    ("spot", "gain"): "sensor_scale",
    ("spot", "sensor_scale"): "gain",
}
"""On a machine, a further name for a family. A steady push on a servo is an offset of the position that it is held to.
A spring has a name where a body keeps its place; so has most dry friction. A servo's load is not its command. A servo
of one axis that goes too far is one whose sensors show too much. Where the only speed is shown too small, a row may be
longer than is said, and parameters make up for the rest. Late commands are late readings of all sensors. A leak into
another body has no name. Where parameters scale what positions make of velocities, speeds that are shown too large are
commands that are followed too far."""


def names_of(family: str, machine: str) -> frozenset[str]:
    """The effects that name a family rightly on a machine."""
    further = EQUIVALENT.get((machine, family))
    return FAMILIES[family].names | ({further} if further else frozenset())
