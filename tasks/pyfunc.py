"""A dynamics model as MLflow loads it: a table of inputs to a table of means and standard deviations.

MLflow keeps this module's name in every logged model and calls `_load_pyfunc` with the stored file, so nothing is
pickled: renaming the module, or that function, orphans the models logged before. It needs no MLflow itself.
"""

from pathlib import Path
from typing import TypedDict

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array, Float
from scipy.special import ndtr, stdtrit

from simgap.models import Model, predict
from tasks.files.models import load_model


class Columns(TypedDict):
    """The names of a model's inputs x and outputs y, in order."""

    inputs: list[str]
    outputs: list[str]


def noise_std(scale: Float[np.ndarray, " y"], dof: Float[np.ndarray, " y"]) -> Float[np.ndarray, " y"]:
    """Half the width of the noise's central 68.3 % interval: scale * F_dof^{-1}(Phi(1)).

    The standard deviation for Gaussian noise. A Student t has none where dof <= 2, and one that says little about
    typical errors where dof is just above; the interval is defined and continuous for every dof.
    """
    return scale * np.where(np.isinf(dof), 1.0, stdtrit(np.where(np.isinf(dof), 1.0, dof), ndtr(1.0)))


class Dynamics:
    """A learnt model of the dynamics over tables, in original units."""

    def __init__(self, model: Model, columns: Columns) -> None:
        self._model, self._columns = model, columns

    def predict(self, model_input: pd.DataFrame) -> pd.DataFrame:
        """`mean_<output>` and `std_<output>`, a row for every row of the inputs.

        std = sqrt(variance of the particles' means + noise_std^2): what is not known and what cannot be known.
        """
        x = model_input[self._columns["inputs"]].to_numpy(np.float32)
        mean, variance, scale, dof = (np.asarray(a, np.float64) for a in _moments(self._model, x))
        std = np.sqrt(variance + noise_std(scale, dof) ** 2)
        outputs = self._columns["outputs"]
        named = [f"mean_{o}" for o in outputs] + [f"std_{o}" for o in outputs]
        return pd.DataFrame(np.hstack([mean, std]), columns=named, index=model_input.index)


@jax.jit
def _moments(model: Model, x: Float[Array, "n x"]) -> tuple[Array, Array, Array, Array]:
    """Mean and variance of the particles' means, scale and dof of the noise, each n by y."""
    p = jax.vmap(predict, in_axes=(None, 0))(model, x)
    return p.mean.mean(1), p.mean.var(1), p.scale, p.dof


def _load_pyfunc(path: str, columns: Columns) -> Dynamics:
    """Called by MLflow, by this name."""
    return Dynamics(load_model(Path(path)), columns)
