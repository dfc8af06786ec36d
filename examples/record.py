"""Recordings of a drive and of a car that have physics which `examples.drive` and `examples.car` leave out.

    python -m examples.record drive FOLDER [--sessions 8] [--seconds 30] [--seed 0]
    python -m examples.record car FOLDER
    python -m examples.record arm FOLDER [--missing friction] [--positions-only]   (see `examples.arm`)
    python -m examples.record drone FOLDER [--missing payload] [--positions-only]   (see `examples.drone`)

The drive has Coulomb friction, with stiction: at rest it stays until the force exceeds the friction. The car's steering
acts 0.15 s after it is commanded. These machines stand in for reality: they share no code with the simulators, only the
names of the columns, and are integrated in steps of 1 ms.
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from examples.car import CAR
from examples.drive import DRIVE
from examples.sessions import Session, write
from simgap.loading import seeds
from simgap.types import StepModel

FINE = 0.001
"""Time step of the integration [s]."""


@dataclass(frozen=True)
class DriveConfig:
    """The real drive and who moves it.

    Drive: `mass` [kg], `damping` [N s/m], `friction` [N]. Sensors: `position_noise` [m], `velocity_noise` [m/s].
    Controller: towards a position within `room` [m], `stiffness` [N/m], `braking` [N s/m], at most `force` [N].
    """

    mass: float = 2.2
    damping: float = 3.5
    friction: float = 2.5
    position_noise: float = 0.0003
    velocity_noise: float = 0.005
    room: float = 0.8
    stiffness: float = 25.0
    braking: float = 6.0
    force: float = 15.0


@dataclass(frozen=True)
class CarConfig:
    """The real car and its driver.

    Car: `wheelbase` [m], `speed_time_constant` [s], `steering_dead_time` [s]. Sensors: `position_noise` [m],
    `yaw_noise` [rad], `speed_noise` [m/s]. Driver: speeds from `slowest` to `fastest` [m/s], steering up to `lock`
    [rad] to either side.
    """

    wheelbase: float = 0.33
    speed_time_constant: float = 0.25
    steering_dead_time: float = 0.15
    position_noise: float = 0.002
    yaw_noise: float = 0.003
    speed_noise: float = 0.01
    slowest: float = -0.5
    fastest: float = 2.0
    lock: float = 0.4


def drive_session(rng: np.random.Generator, rows: int, time_step: float, config: DriveConfig) -> Session:
    """A drive that is sent to one place after another, from rest in the middle."""
    target = config.room * _wishes(rng, rows, time_step)
    noise = rng.normal(0.0, (config.position_noise, config.velocity_noise), (rows, 2))
    states, commands = np.empty((rows, 2)), np.empty((rows, 1))
    position = velocity = 0.0
    for row in range(rows):
        states[row] = measured = (position, velocity) + noise[row]
        force = config.stiffness * (target[row] - measured[0]) - config.braking * measured[1]
        commands[row] = force = min(max(force, -config.force), config.force)
        for _ in range(round(time_step / FINE)):
            free = velocity + FINE * (force - config.damping * velocity) / config.mass
            # Friction takes what it can of the velocity and never reverses it: where it can take all, the drive sticks.
            then = math.copysign(max(abs(free) - FINE * config.friction / config.mass, 0.0), free)
            position, velocity = position + FINE * (velocity + then) / 2, then
    return states, commands


def car_session(rng: np.random.Generator, rows: int, time_step: float, config: CarConfig) -> Session:
    """A car that is driven about, from rest at the origin."""
    middle, half = (config.fastest + config.slowest) / 2, (config.fastest - config.slowest) / 2
    commands = np.column_stack(
        [middle + half * _wishes(rng, rows, time_step), config.lock * _wishes(rng, rows, time_step)]
    )
    true, fine_steps, late = np.empty((rows, 4)), round(time_step / FINE), round(config.steering_dead_time / FINE)
    x = y = yaw = speed = 0.0
    for row in range(rows):
        true[row] = x, y, yaw, speed
        for fine in range(row * fine_steps, (row + 1) * fine_steps):
            acting = commands[(fine - late) // fine_steps, 1] if fine >= late else 0.0
            gained = FINE * (commands[row, 0] - speed) / config.speed_time_constant
            turned = FINE * (speed + gained / 2) * math.tan(acting) / config.wheelbase
            x += FINE * (speed + gained / 2) * math.cos(yaw + turned / 2)
            y += FINE * (speed + gained / 2) * math.sin(yaw + turned / 2)
            speed, yaw = speed + gained, yaw + turned
    scale = (config.position_noise, config.position_noise, config.yaw_noise, config.speed_noise)
    states = true + rng.normal(0.0, scale, true.shape)
    states[:, 2] = np.pi - (np.pi - states[:, 2]) % (2 * np.pi)  # to (-pi, pi]
    return states, commands


def _wishes(rng: np.random.Generator, rows: int, time_step: float) -> Float[np.ndarray, " T"]:
    """What a person wants, in [-1, 1]: held for 0.5 to 2.5 s, then something else, as fast as a hand moves (0.1 s)."""
    held: list[float] = []
    while len(held) < rows:
        # A fifth of the time hands off: rest and starts from rest show friction and play.
        value = 0.0 if rng.random() < 0.2 else rng.uniform(-1.0, 1.0)
        held += [value] * round(rng.uniform(0.5, 2.5) / time_step)
    keep, hand, wishes = math.exp(-time_step / 0.1), 0.0, np.empty(rows)
    for row in range(rows):
        hand = wishes[row] = keep * hand + (1 - keep) * held[row]
    return wishes


MACHINES: dict[str, tuple[StepModel, Callable[[np.random.Generator, int, float], Session]]] = {
    "drive": (DRIVE, lambda rng, rows, time_step: drive_session(rng, rows, time_step, DriveConfig())),
    "car": (CAR, lambda rng, rows, time_step: car_session(rng, rows, time_step, CarConfig())),
}
"""For each machine the simulator, whose columns and time step the recordings have, and what makes a session."""
SECONDS = {"arm": 8.0, "drone": 8.0}
"""Machines with a model file, and the length of their sessions [s]."""


def record(machine: str, folder: Path, sessions: int, seconds: float, seed: int) -> list[Path]:
    """Write a recording set of a machine, each session `seconds` [s] long; returns the files."""
    simulator, session = MACHINES[machine]
    step = simulator.time_step
    sizes = sessions, seconds, seed
    return write(folder, machine, sizes, simulator.schema, step, lambda rng, rows: session(rng, rows, step))


def _number(kind: type[int | float], low: float, high: float) -> Callable[[str], Any]:
    """What reads the number of an option, and refuses one that is not between these."""

    def read(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            what = "whole number" if kind is int else "number"
            raise argparse.ArgumentTypeError(f"must be a {what} from {low:,} to {high:,}; it is {text!r:.40}")
        return value

    return read


def record_model(machine: str, folder: Path, sizes: tuple[int, float, int], missing: str, speeds: bool) -> list[Path]:
    """The same of a machine with a model file, which needs MuJoCo; sizes: sessions, seconds, seed.

    Raises ValueError where its model cannot lack `missing`; empty: what it lacks by default.
    """
    from examples import arm, drone

    known, config, record_it = {
        "arm": (arm.MISSING, arm.ArmConfig, arm.record_arm),
        "drone": (drone.MISSING, drone.DroneConfig, drone.record_drone),
    }[machine]
    if missing and missing not in known:
        raise ValueError(f"--missing {missing}: expected one of {', '.join(known)}")
    return record_it(folder, *sizes, config(missing or config.missing, speeds))


def main() -> None:
    parser = argparse.ArgumentParser(
        "python -m examples.record", description="Record a machine whose physics its simulator leaves out."
    )
    parser.add_argument("machine", choices=[*MACHINES, *SECONDS])
    parser.add_argument("folder", type=Path, help="folder to write the recording set to")
    parser.add_argument("--sessions", type=_number(int, 1, 1000), default=8)
    parser.add_argument(
        "--seconds",
        type=_number(float, 0.1, 3600),
        help="length of a session [s]; 8 for the arm and the drone, 30 for the others",
    )
    parser.add_argument("--seed", type=_number(int, 0, seeds.LARGEST), default=0)
    parser.add_argument("--missing", default="", help="what the model leaves out (arm and drone only)")
    parser.add_argument("--positions-only", action="store_true", help="record no velocities (arm and drone only)")
    given = parser.parse_args()
    seconds = given.seconds or SECONDS.get(given.machine, 30.0)
    if given.machine in SECONDS:
        sizes = given.sessions, seconds, given.seed
        try:
            paths = record_model(given.machine, given.folder, sizes, given.missing, not given.positions_only)
        except ValueError as error:
            parser.error(str(error))
    else:
        paths = record(given.machine, given.folder, given.sessions, seconds, given.seed)
    print(f"{given.folder}: {len(paths)} x {seconds:g} s of the {given.machine}")


if __name__ == "__main__":
    main()
