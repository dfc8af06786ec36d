"""The predictive distribution of every learnt model, in original units."""

from jaxtyping import Array, Float

from simgap import models
from simgap.residual import model as residual
from simgap.residual.model import ResidualModel
from simgap.types import Prediction

Model = models.Model | ResidualModel


def predict(model: Model, x: Float[Array, " x"]) -> Prediction:
    """p(y | x): a mixture with noise [Hoffman et al. 2025, Learning with BNNs]."""
    return residual.predict(model, x) if isinstance(model, ResidualModel) else models.predict(model, x)


def steady(model: Model, x: Float[Array, " x"]) -> Float[Array, "L y"]:
    """What each particle predicts of a row of a long prediction: its mean, but where rows last unequally long."""
    return residual.steady(model, x) if isinstance(model, ResidualModel) else models.predict(model, x).mean
