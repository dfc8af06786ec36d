"""A diagnosed simulator as MLflow loads it: a table of states and commands to a table of next states.

As `tasks.pyfunc`: MLflow keeps this module's name and calls `_load_pyfunc`; renaming either orphans logged simulators.
A simulator of a user's own must be importable where it is loaded.
"""

from pathlib import Path
from typing import TypedDict

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from simgap.formats.diagnoses import read_simulator
from simgap.loading.load import load
from simgap.recordings import HISTORY
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.refitted import nominal
from simgap.types import Schema


class Origin(TypedDict):
    """The simulator's name, as `simgap.loading.load` takes it."""

    simulator: str


def input_columns(schema: Schema) -> list[str]:
    """Names of the state and the commands, those k rows before with the suffix `_k`, the oldest first."""
    commands = [f"{c.name}_{k}" if k else c.name for k in range(HISTORY, -1, -1) for c in schema.command]
    return [*(f.name for f in schema.state), *commands]


def output_columns(schema: Schema) -> list[str]:
    """Names of the next state."""
    return [f"next_{f.name}" for f in schema.state]


class NextStates:
    """A simulator with the effects that a diagnosis found, with the parameters fitted along with them, over tables."""

    def __init__(self, simulator: AugmentedSimulator, phi: Float[np.ndarray, " p"]) -> None:
        schema = simulator.schema
        self._inputs, self._outputs = input_columns(schema), output_columns(schema)
        n, size = len(schema.state), len(schema.command)

        def step(row: Float[Array, " x"]) -> Float[Array, " s"]:
            return simulator.step_from_history(phi, row[:n], row[n:].reshape(HISTORY + 1, size))  # type: ignore[arg-type]

        self._step = jax.jit(jax.vmap(step))

    def predict(self, model_input: pd.DataFrame) -> pd.DataFrame:
        """A next state for every row of the inputs."""
        rows = model_input[self._inputs].to_numpy(np.float32)
        return pd.DataFrame(np.asarray(self._step(rows), np.float64), columns=self._outputs, index=model_input.index)


def _load_pyfunc(path: str, origin: Origin) -> NextStates:
    """Called by MLflow, by this name."""
    simulator = read_simulator(Path(path), load(origin["simulator"]))
    return NextStates(simulator, nominal(simulator))
