"""A diagnosed simulator as MLflow loads it: a session's table to a table of next states.

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
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.refitted import nominal
from simgap.types import Schema
from tasks import history


class Origin(TypedDict):
    """The simulator's name, as `simgap.loading.load` takes it."""

    simulator: str


def output_columns(schema: Schema) -> list[str]:
    """Names of the next state."""
    return [f"next_{f.name}" for f in schema.state]


class NextStates:
    """A simulator with the effects that a diagnosis found, with the parameters fitted along with them, over tables."""

    def __init__(self, simulator: AugmentedSimulator, phi: Float[np.ndarray, " p"]) -> None:
        self._schema = simulator.schema

        def step(state: Float[Array, " s"], commands: Float[Array, "3 u"]) -> Float[Array, " s"]:
            return simulator.step_from_history(phi, state, commands)  # type: ignore[arg-type]

        self._step = jax.jit(jax.vmap(step))

    def predict(self, model_input: pd.DataFrame) -> pd.DataFrame:
        """A next state for every row of a session with the columns of a recording file.

        Of the first two rows, whose past commands are not there, nothing is predicted (NaN). Raises RecordingError as
        `tasks.history.rows` does.
        """
        rows = history.rows(self._schema, model_input)
        then = np.where(rows.complete[:, None], np.asarray(self._step(rows.state, rows.commands), np.float64), np.nan)
        return pd.DataFrame(then, columns=output_columns(self._schema), index=model_input.index)


def _load_pyfunc(path: str, origin: Origin) -> NextStates:
    """Called by MLflow, by this name."""
    simulator = read_simulator(Path(path), load(origin["simulator"]))
    return NextStates(simulator, nominal(simulator))
