"""A dynamics model of Spot as MLflow loads it: a session's table to a table of means and standard deviations.

MLflow keeps this module's name in every logged model and calls `_load_pyfunc` with the stored file, so nothing is
pickled: renaming the module, or that function, orphans the models logged before. It needs no MLflow itself.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float
from scipy.special import ndtr, stdtrit

from simgap.prediction import Model, predict
from simgap.recordings import encode_state
from simgap.simulators.spot import SCHEMA
from tasks import history
from tasks.files.models import load_model


def noise_std(scale: Float[np.ndarray, " y"], dof: Float[np.ndarray, " y"]) -> Float[np.ndarray, " y"]:
    """Half the width of the noise's central 68.3 % interval: scale * F_dof^{-1}(Phi(1)).

    The standard deviation for Gaussian noise. A Student t has none where dof <= 2, and one that says little about
    typical errors where dof is just above; the interval is defined and continuous for every dof.
    """
    return scale * np.where(np.isinf(dof), 1.0, stdtrit(np.where(np.isinf(dof), 1.0, dof), ndtr(1.0)))


class Dynamics:
    """A learnt model of the dynamics over tables, in original units."""

    def __init__(self, model: Model) -> None:
        self._model = model

    def predict(self, model_input: pd.DataFrame) -> pd.DataFrame:
        """The change of the state to the next row, for every row of a session with the columns of a recording file.

        Columns `mean_<output>` and `std_<output>`; an angle has its sine and cosine as outputs. Of the first two rows,
        whose past commands are not there, nothing is predicted (NaN).
        std = sqrt(variance of the particles' means + noise_std^2): what is not known and what cannot be known.
        Raises RecordingError as `tasks.history.rows` does.
        """
        rows = history.rows(SCHEMA, model_input)
        mean, variance, scale, dof = (
            np.asarray(a, np.float64) for a in _moments(self._model, rows.state, rows.commands)
        )
        std = np.sqrt(variance + noise_std(scale, dof) ** 2)
        values = np.where(rows.complete[:, None], np.hstack([mean, std]), np.nan)
        return pd.DataFrame(values, columns=output_columns(), index=model_input.index)


def output_columns() -> list[str]:
    """Names of what is predicted."""
    return [f"{moment}_{name}" for moment in ("mean", "std") for name in SCHEMA.encoded]


@jax.jit
def _moments(
    model: Model, state: Float[Array, "n s"], commands: Float[Array, "n 3 u"]
) -> tuple[Array, Array, Array, Array]:
    """Mean and variance of the particles' means, scale and dof of the noise, each n by y."""
    encoded = jax.vmap(lambda s: encode_state(SCHEMA, s))(state)
    x = jnp.concatenate([encoded, commands.reshape(len(state), -1)], axis=1)
    p = jax.vmap(predict, in_axes=(None, 0))(model, x)
    return p.mean.mean(1), p.mean.var(1), p.scale, p.dof


def _load_pyfunc(path: str) -> Dynamics:
    """Called by MLflow, by this name."""
    return Dynamics(load_model(Path(path)))
