"""What several files of tests are given."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from simgap.models import FittedSpot
from simgap.simulators import parameter_ranges
from simgap.simulators.spot import Spot


def spot_recordings() -> Path:
    """The published recordings of a real Spot, which the project does not hold itself."""
    default = Path(__file__).parents[2] / "shared" / "recordings" / "spot"
    folder = Path(os.environ.get("SIMGAP_SPOT_RECORDINGS", default))
    if not folder.is_dir():
        pytest.skip(f"no recordings of a real Spot in {folder}; name their folder in SIMGAP_SPOT_RECORDINGS")
    return folder


@contextmanager
def scratch() -> Iterator[Path]:
    """A folder for one of hypothesis' examples."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def fitted_spot() -> FittedSpot:
    low, high = parameter_ranges(Spot())
    scale = np.full(13, 0.1, np.float32)
    return FittedSpot((low + high) / 2, scale, 30 * scale, np.float32(1 / 15))  # type: ignore[arg-type]
