"""A policy as MLflow loads it: a table of what is measured, commanded and wanted to a table of commands.

As `tasks.pyfunc`: MLflow keeps this module's name and calls `_load_pyfunc`; renaming either orphans logged policies.
"""

from pathlib import Path
from typing import TypedDict

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from simgap.policies.actor import Actor
from simgap.recordings import HISTORY
from simgap.simulators.spot import SCHEMA
from tasks.files.models import load_policy


class Columns(TypedDict):
    """The names of what goes into a policy and what comes out, in order."""

    inputs: list[str]
    outputs: list[str]


class Commands:
    """A policy over tables: state, the last two commands and the goal in, commands out [m/s, rad/s]."""

    def __init__(self, policy: Actor, columns: Columns) -> None:
        self._policy, self._columns = policy, columns

    def predict(self, model_input: pd.DataFrame) -> pd.DataFrame:
        """A row of commands for every row of the inputs."""
        rows = model_input[self._columns["inputs"]].to_numpy(np.float32)
        commands = np.asarray(_commands(self._policy, rows), np.float64)
        return pd.DataFrame(commands, columns=self._columns["outputs"], index=model_input.index)


@jax.jit
def _commands(policy: Actor, rows: Float[Array, "n 27"]) -> Float[Array, "n 6"]:
    s, u = len(SCHEMA.state), len(SCHEMA.command)

    def command(row: Float[Array, " 27"]) -> Float[Array, " 6"]:
        return policy.command(row[:s], row[s : s + HISTORY * u].reshape(HISTORY, u), row[-3:])

    return jax.vmap(command)(rows)


def _load_pyfunc(path: str, columns: Columns) -> Commands:
    """Called by MLflow, by this name."""
    return Commands(load_policy(Path(path)), columns)
