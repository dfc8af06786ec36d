"""Learn a robot from little data, and say what its simulator leaves out.

`diagnose(simulator, recordings)` gives a `Result`; `load(folder)` gives the simulator that a diagnosis corrected.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simgap.api import diagnose, load
    from simgap.loading.model_files import ModelFile
    from simgap.result import Effect, Result
    from simgap.simulators.refitted import nominal
    from simgap.types import Field, Parameter, Recording, Schema, SimgapError, StepModel

__all__ = [
    "Effect", "Field", "ModelFile", "Parameter", "Recording", "Result", "Schema", "SimgapError", "StepModel",
    "diagnose", "load", "nominal",
]  # fmt: skip
_HOMES = {
    "simgap.api": ("diagnose", "load"),
    "simgap.loading.model_files": ("ModelFile",),
    "simgap.result": ("Effect", "Result"),
    "simgap.simulators.refitted": ("nominal",),
    "simgap.types": ("Field", "Parameter", "Recording", "Schema", "SimgapError", "StepModel"),
}


def __getattr__(name: str) -> Any:
    """Public names, imported when they are asked for: JAX takes seconds, and a wrong argument needs none of it."""
    if name == "__version__":
        from importlib.metadata import version

        return version("simgap")
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(home), name)
    raise AttributeError(f"module 'simgap' has no attribute {name!r}")
