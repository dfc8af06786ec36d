"""The learnt model: the fitted simulator, rows of unequal duration, and particles of a residual."""

from dataclasses import dataclass
from functools import partial

import jax
from jaxtyping import Array, Float

from simgap import networks
from simgap.residual import body, duration
from simgap.types import Prediction, Simulator


@partial(
    jax.tree_util.register_dataclass,
    data_fields=(
        "params", "durations", "pace", "carried", "particles", "feature_mean", "feature_std", "unit", "scale", "dof"
    ),
    meta_fields=("simulator",),
)  # fmt: skip
@dataclass(frozen=True)
class ResidualModel:
    """A simulator with fitted parameters, its rows' durations, L particles of what it misses a step, and noise.

    durations: Q equally likely ones of a row; pace: that of the rows of a long prediction, both in steps of the
    simulator; carried: 1 where long predictions take the residual along, 0 where they do not. Particles take features
    less `feature_mean` in units of `feature_std`, and give the residual along the axes of each body's own frame in
    units of `unit` [original units a step]. scale and dof: of the noise, in original units.
    """

    simulator: Simulator
    params: Float[Array, " p"]
    durations: Float[Array, " q"]
    pace: Float[Array, ""]
    carried: Float[Array, ""]
    particles: networks.Particles
    feature_mean: Float[Array, " f"]
    feature_std: Float[Array, " f"]
    unit: Float[Array, " s"]
    scale: Float[Array, " y"]
    dof: Float[Array, " y"]


def predict(model: ResidualModel, x: Float[Array, " x"]) -> Prediction:
    """p(y | x): a mixture over particles and durations."""
    changes = _changes(model, x, model.durations, 1.0)
    return Prediction(changes.reshape(-1, changes.shape[-1]), model.scale, model.dof)


def steady(model: ResidualModel, x: Float[Array, " x"]) -> Float[Array, "L y"]:
    """What each particle predicts of a row that lasts as long as rows do in a long prediction."""
    return _changes(model, x, model.pace[None], model.carried)[:, 0]


def _changes(
    model: ResidualModel, x: Float[Array, " x"], durations: Float[Array, " q"], carried: Float[Array, ""] | float
) -> Float[Array, "L q y"]:
    simulated = duration.after(duration.path(model.simulator, model.params, x), durations)
    features = (body.features(model.simulator, x) - model.feature_mean) / model.feature_std
    missed = carried * model.unit * networks.apply(model.particles, features[None])[:, 0]
    return simulated + durations[:, None] * (missed @ body.lift(model.simulator.schema, x).T)[:, None]
