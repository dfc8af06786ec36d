"""What recordings of all example machines have in common."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from simgap.formats.recordings import write_recording
from simgap.types import Recording, Schema

Session = tuple[Float[np.ndarray, "T s"], Float[np.ndarray, "T u"]]
"""States as measured, and commands as sent."""


@dataclass(frozen=True)
class ModelConfig:
    """How a machine with a model file is recorded.

    missing: what the model leaves out, of the machine's `MISSING`. speeds: whether recordings have velocities.
    time_step [s] between rows. position_noise [m, rad], velocity_noise [m/s, rad/s].
    """

    missing: str = "nothing"
    speeds: bool = True
    time_step: float = 0.02
    position_noise: float = 0.001
    velocity_noise: float = 0.005


def write(
    folder: Path,
    machine: str,
    sizes: tuple[int, float, int],
    schema: Schema,
    time_step: float,
    session: Callable[[np.random.Generator, int], Session],
) -> list[Path]:
    """Write a recording set and return its files. sizes: number of sessions, their length [s], seed."""
    sessions, seconds, seed = sizes
    rows, paths = round(seconds / time_step), []
    for i, rng in enumerate(np.random.default_rng(seed).spawn(sessions)):
        states, commands = session(rng, rows)
        recording = Recording(f"{machine}_{i + 1:02d}", np.arange(rows) * time_step, states, commands)
        paths.append(write_recording(folder, recording, schema))
    return paths
