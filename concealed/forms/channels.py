"""Channels of the command, and the velocities that they move."""

from typing import Any

import numpy as np

from concealed.form import Array, Form, Now
from concealed.plain import COMMAND

UNITS = ("m/s", "m/s", "rad/s", "m/s", "m/s", "m/s")
OUTPUT_OF = ("base_vx", "base_vy", "base_wz", "ee_vx", "ee_vy", "ee_vz")
GROUPS = ((0, 1, 2), (3, 4, 5))


def outputs_of(channels: tuple[int, ...]) -> tuple[str, ...]:
    """Velocities in the world frame that commands of the body frame move: x and y are turned into each other."""
    found = [OUTPUT_OF[c] for c in channels]
    for pair in ((0, 1), (3, 4)):
        if any(c in channels for c in pair):
            found += [OUTPUT_OF[c] for c in pair]
    return tuple(dict.fromkeys(found))


class OnChannels(Form):
    """A form that acts on some of the six commands."""

    def __init__(self, rng: np.random.Generator, groups: bool = False, channels: tuple[int, ...] | None = None) -> None:
        drawn = GROUPS[rng.integers(2)] if groups else (int(rng.integers(6)),)
        self.on: tuple[int, ...] = channels or drawn
        self.channels = tuple(COMMAND[c] for c in self.on)
        self.outputs = outputs_of(self.on)

    @property
    def unit(self) -> str:
        return UNITS[self.on[0]]

    def command(self, now: Now, u: Array) -> Array:
        u = u.copy()
        for c in self.on:
            u[:, :, c] = self.follow(now, c, u[:, :, c])
        return u

    def follow(self, now: Now, c: int, u: Array) -> Array:
        """What becomes of channel c over the substeps [K, B]."""
        return u

    def one(self, name: str, value: float, unit: str) -> list[dict[str, Any]]:
        return [{"name": name, "value": value, "unit": unit}]
