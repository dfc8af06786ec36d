"""Robots given as a model file (MJCF or URDF), which MuJoCo steps.

Cheap to import, as `names` is: a wrong file name is reported before JAX is loaded.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from simgap.formats.column_names import listed, nearest
from simgap.types import ConfigError, Schema, SimgapError

if TYPE_CHECKING:
    from simgap.engines import Engine
    from simgap.formats.peek import Seen

SUFFIXES = (".xml", ".mjcf", ".urdf")
"""What the name of a model file may end in, in upper or lower case."""
PerJoint = float | Mapping[str, float] | None
"""A value for all joints, or for some by name."""
STRONGEST = 1e9
"""Maximum of a servo's stiffness, damping and force, in SI units: beyond any machine, and sums stay finite."""


@dataclass(frozen=True)
class ModelFile:
    """A robot's MJCF or URDF as the simulator, with position servos for joints that have no actuator in it.

    kp: stiffness [N m/rad, N/m]. kv: damping by the servo [N m s/rad, N s/m]. force_limit: maximum force [N m, N].
    Each is for all these joints, or for some by name. ConfigError names a value that no servo can have.
    """

    path: str | Path
    kp: PerJoint = None
    kv: PerJoint = None
    force_limit: PerJoint = None

    def __post_init__(self) -> None:
        for option in ("kp", "kv", "force_limit"):
            given = getattr(self, option)
            for joint, value in given.items() if isinstance(given, Mapping) else (("", given),):
                if value is not None and not _is_possible(option, value):
                    raise ConfigError(
                        f"{self.path}: {option}{joint and f' of {joint}'} is {value!r:.40}; it must be a number "
                        f"{'from' if option == 'kv' else 'above'} 0 to {STRONGEST:.0e}. Correct it, or leave it out."
                    )

    def __str__(self) -> str:
        return str(self.path)

    def check(self) -> None:
        """ConfigError where there is no such file, or MuJoCo is not installed."""
        if not Path(self.path).is_file():
            raise ConfigError(f"{self.path}: there is no such file. Give the path of the robot's MJCF or URDF.")
        if importlib.util.find_spec("mujoco") is None:
            raise ConfigError(f"{self.path}: to step a model, MuJoCo must be installed: pip install 'simgap[mujoco]'.")

    def engine(self, seen: Seen) -> Engine:
        """The engine that steps the model, for recordings with these columns and this interval.

        Raises SimgapError where the model cannot be read, ConfigError where no column belongs to a joint of it.
        """
        self.check()
        from simgap.simulators.mujoco import Servos, load

        servos = Servos(self.kp, self.kv, self.force_limit)
        try:
            return cast("Engine", load(Path(self.path), seen.time_step, seen.columns, servos))
        except SimgapError:
            known = self.columns(seen.time_step)  # raises where the model is wrong
            raise ConfigError(
                f"{self.path}: no joint of the model is recorded. It takes the columns {listed(known)}, of which the "
                f"positions of some joints must be there; the recordings have {listed(seen.columns)}"
                f"{nearest(seen.columns, known)}. Rename the columns, or convert the recordings with a mapping: simgap "
                "import (docs/how_to/mujoco.md)."
            ) from None

    def columns(self, time_step: float) -> tuple[str, ...]:
        """All columns that recordings of the model could have, `time_s` first; SimgapError where it cannot be read."""
        return self.described(time_step)[0].columns

    def described(self, time_step: float) -> tuple[Schema, dict[str, tuple[float, float]]]:
        """The schema with all columns that the model could have, and the ranges of its joints by name [rad, m]."""
        self.check()
        from simgap.simulators.mujoco import Servos, load
        from simgap.simulators.mujoco.machine import ranges

        engine = load(Path(self.path), time_step, None, Servos(self.kp, self.kv, self.force_limit))
        return engine.schema, ranges(engine.model, engine.machine)

    def remembered(self, seen: Seen) -> dict[str, Any]:
        """The record of it in `diagnosis.json`, as `recalled` reads it."""
        return {**asdict(self), "path": str(Path(self.path).resolve()), **seen._asdict(), "start": {}}


def _is_possible(option: str, value: Any) -> bool:
    """Whether a servo can have this value: damping may be zero; stiffness and force limit may not."""
    return issubclass(type(value), Real) and (value > 0 or (value == 0 and option == "kv")) and value <= STRONGEST


def recalled(kept: Mapping[str, Any]) -> Engine:
    """The engine that `ModelFile.remembered` recorded; ConfigError where its file is no longer there."""
    from simgap.formats.peek import Seen

    options = {name: kept[name] for name in ("path", "kp", "kv", "force_limit")}
    engine = ModelFile(**options).engine(Seen(tuple(kept["columns"]), kept["time_step"]))
    if not kept["start"]:
        return engine
    from simgap.simulators.mujoco import rescaled

    return cast("Engine", rescaled(cast(Any, engine), kept["start"]))


def named(spec: str) -> str | ModelFile:
    """The model file that a text names, or else the text itself: the name of a simulator."""
    return ModelFile(spec) if Path(spec).suffix.lower() in SUFFIXES else spec
