"""A kind of missing physics of the training ground, and which machines have what."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from simgap.ground.laws import Law
from simgap.ground.machines import MACHINES

ALL = tuple(m.name for m in MACHINES)
HELD = ("servo", "servo_positions", "arm", "arm_positions")
"""Machines that servos hold at a commanded position."""
STAYING = (*HELD, "cart", "pendulum", "pendulum_positions", "pair", "pair_left", "trolley", "links")
"""Machines whose bodies keep their place."""
READ = tuple(m.name for m in MACHINES if all(f.observed for f in m.schema.state))
"""Machines that record the speeds of all their axes."""
JOINED = ("pair", "pair_left", "base", "arm", "arm_positions", "wheels")
"""Machines of several axes, all of which may leak into the next one."""
RUBBING = tuple(m for m in ALL if m != "flyer")
"""Machines that touch what they move on or turn about."""


class Family(NamedTuple):
    """A kind of missing physics: the effects that name it rightly, and how one of it is drawn, `draw(rng, size, row,
    rate)`. row: length of a row [s]; rate: the machine's acceleration per unit of command [1/s^2]. machines: those that
    can have it. axes: those along which it acts, where these are not drawn."""

    names: frozenset[str]
    draw: Callable[[np.random.Generator, float, float, float], Law]
    machines: tuple[str, ...] = ALL
    axes: tuple[int, ...] = ()


def named(*effects: str) -> frozenset[str]:
    """Names of a family."""
    return frozenset(effects)
