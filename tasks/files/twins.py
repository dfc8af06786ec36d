"""Twins as `.npz`."""

from dataclasses import fields
from pathlib import Path

import numpy as np

from simgap.formats.arrays import load_arrays, save_arrays
from simgap.robots.twin.model import Twin
from simgap.types import SimgapError
from tasks.files.models import residual_arrays, residual_model

_OWN = [field.name for field in fields(Twin) if field.name != "model"]
_PREFIX = "twin_"  # a model has durations as well: those of its law


def save_twin(path: Path, twin: Twin) -> None:
    """Write a twin: its model's arrays by name, and its own, which begin with `twin_`."""
    own = {_PREFIX + name: getattr(twin, name) for name in _OWN}
    arrays = {"kind": Twin.__name__, **residual_arrays(twin.model), **own}
    save_arrays(path, {name: np.asarray(array) for name, array in arrays.items()})


def load_twin(path: Path) -> Twin:
    """The twin that `save_twin` wrote, its arrays numpy's; SimgapError when the file holds none."""
    arrays = load_arrays(path)
    kind = str(arrays.pop("kind", "none"))
    try:
        if kind != Twin.__name__:
            raise ValueError(f"its kind is {kind[:40]!r}")
        own = {name: arrays.pop(_PREFIX + name) for name in _OWN}
        return Twin(residual_model(arrays), **own)  # type: ignore[arg-type]  # numpy's arrays serve as jax's
    except (KeyError, TypeError, ValueError) as error:
        raise SimgapError(f"{path}: holds no twin of this version ({error}). Run the stage `twin`.") from None
