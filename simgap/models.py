"""Learnt dynamics models: what fitting leaves behind, and its predictive distribution in original units."""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap import networks
from simgap.recordings import Normalisation
from simgap.simulators import state_difference
from simgap.simulators.spot import Spot
from simgap.types import Prediction, Simulator


class BNN(NamedTuple):
    """L particles of a Bayesian neural network with their shared noise, in normalised units (FSVGD and Sim-FSVGD)."""

    particles: networks.Particles
    scale: Float[Array, " y"]
    dof: Float[Array, " y"]
    normalisation: Normalisation


class FittedSpot(NamedTuple):
    """SIM-MODEL: the kinematic model with fitted parameters and noise, in original units."""

    params: Float[Array, " 24"]
    scale: Float[Array, " y"]
    dof: Float[Array, " y"]
    time_step: Float[Array, ""]  # [s]


@partial(jax.tree_util.register_dataclass, data_fields=("params", "scale", "dof"), meta_fields=("simulator",))
@dataclass(frozen=True)
class FittedSimulator:
    """SIM-MODEL with another simulator, such as a diagnosed one, which is known when the model is compiled."""

    simulator: Simulator
    params: Float[Array, " p"]
    scale: Float[Array, " y"]
    dof: Float[Array, " y"]


Model = BNN | FittedSpot | FittedSimulator


def predict(model: Model, x: Float[Array, " x"]) -> Prediction:
    """p(y | x): a mixture over particles with noise [Hoffman et al. 2025, Learning with BNNs]."""
    if isinstance(model, FittedSpot):
        simulator = Spot(time_step=model.time_step)  # type: ignore[arg-type]  # an array traces like a float
        return Prediction(state_difference(simulator, model.params, x)[None], model.scale, model.dof)
    if isinstance(model, FittedSimulator):
        return Prediction(state_difference(model.simulator, model.params, x)[None], model.scale, model.dof)
    n = model.normalisation
    h = networks.apply(model.particles, ((x - n.x_mean) / n.x_std)[None])[:, 0]
    return Prediction(n.y_mean + n.y_std * h, n.y_std * model.scale, model.dof)


def mean(prediction: Prediction) -> Float[Array, " y"]:
    """Mean of the mixture."""
    return jnp.mean(prediction.mean, axis=0)
