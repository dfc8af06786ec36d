"""What several files of tests are given."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simgap.models import FittedSpot
from simgap.simulators import parameter_ranges
from simgap.simulators.spot import Spot

TRAINING_SIZES: dict[str, Any] = {
    # One evaluation: steps after it are a program of their own.
    "bnn": {"max_training_steps": 100, "evaluate_every": 100, "measurement_sets": 8, "hidden_layer_sizes": [16]},
    "sim_model": {"training_steps": 100, "evaluate_every": 100},
    "residual": {"simulator_steps": 50, "training_steps": 50, "evaluate_every": 25, "outputscales": [0.1],
                 "lengthscales": [2.0], "horizon": 10},
}  # fmt: skip
"""Training in a small size, as overrides of the project's parameters. Wherever the size does not matter, tests take
this one, and those below: programs take longer to compile than to run, and are compiled once for all tests."""
POLICY_SIZES: dict[str, Any] = {
    "learning": {"environment_steps": 640, "environments": 16, "updates": 16, "episode_length": 20,
                 "steps_between_updates": 4, "min_replay": 128, "max_replay": 1000, "evaluations": 3,
                 "evaluation_environments": 8},
    "sac": {"policy_hidden_layers": [8], "critic_hidden_layers": [8]},
}  # fmt: skip
"""The same for a policy's learning."""


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
