"""Learnt models and policies as `.npz`."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array

from simgap.formats.arrays import load_arrays, save_arrays
from simgap.formats.effects import augmented_arrays, augmented_spot
from simgap.models import BNN, FittedSimulator, FittedSpot
from simgap.policies.actor import Actor
from simgap.prediction import Model
from simgap.recordings import Normalisation
from simgap.residual.model import ResidualModel
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.spot import Spot
from simgap.types import SimgapError

_KIND_SHOWN = 40  # characters of a file's own text in a message


def save_model(path: Path, model: Model) -> None:
    """Write a model as `.npz`: its `kind` and its arrays by name, the layers' as `weight_0`, `bias_0`, `weight_1`..."""
    if isinstance(model, BNN):
        arrays = {**_layer_arrays(model.particles), "scale": model.scale, "dof": model.dof,
                  **model.normalisation._asdict()}  # fmt: skip
    elif isinstance(model, FittedSimulator):
        arrays = {"params": model.params, "scale": model.scale, "dof": model.dof,
                  **augmented_arrays(_augmented_spot(model.simulator))}  # fmt: skip
    elif isinstance(model, ResidualModel):
        arrays = residual_arrays(model)
    else:
        arrays = model._asdict()
    kind = type(model).__name__
    save_arrays(path, {name: np.asarray(array) for name, array in {"kind": kind, **arrays}.items()})


def load_model(path: Path) -> Model:
    """The model that `save_model` wrote, bit for bit, its arrays numpy's; SimgapError when the file holds none."""
    arrays = load_arrays(path)
    kind = str(arrays.pop("kind", "none"))
    try:
        if kind == FittedSpot.__name__:
            return FittedSpot(**arrays)  # type: ignore[arg-type]  # numpy's arrays serve as jax's
        if kind == FittedSimulator.__name__:
            return FittedSimulator(augmented_spot(arrays), **arrays)  # type: ignore[arg-type]  # as above
        if kind == ResidualModel.__name__:
            return residual_model(arrays)
        if kind == BNN.__name__:
            return _bnn(arrays)
    except (KeyError, TypeError, ValueError) as error:
        raise SimgapError(
            f"{path}: a {kind} with other arrays than this version's ({error}). Train the model again."
        ) from None
    raise SimgapError(
        f"{path}: holds no model; its kind is {kind[:_KIND_SHOWN]!r} and must be {BNN.__name__}, "
        f"{FittedSpot.__name__}, {FittedSimulator.__name__} or {ResidualModel.__name__}. "
        "Give a file of the stage `train`."
    )


def residual_arrays(model: ResidualModel) -> dict[str, Any]:
    """Its arrays by name, those of its simulator and of its layers among them."""
    own = {field.name: getattr(model, field.name) for field in fields(model)}
    layers, simulator = own.pop("particles"), own.pop("simulator")
    return {**_layer_arrays(layers), **augmented_arrays(_augmented_spot(simulator)), **own}


def residual_model(arrays: dict[str, np.ndarray]) -> ResidualModel:
    """Takes all of the arrays; KeyError or TypeError when one is missing or left over."""
    return ResidualModel(augmented_spot(arrays), particles=_pop_layers(arrays), **arrays)  # type: ignore[arg-type]


def _bnn(arrays: dict[str, np.ndarray]) -> BNN:
    """Takes all of the arrays; KeyError or TypeError when one is missing or left over."""
    particles = _pop_layers(arrays)
    stats = Normalisation(*(arrays.pop(name) for name in Normalisation._fields))  # type: ignore[arg-type]
    return BNN(particles, normalisation=stats, **arrays)  # type: ignore[arg-type]


def save_policy(path: Path, policy: Actor) -> None:
    """Write a policy as `.npz`: `weight_0`, `bias_0`, `weight_1`..., `mean` and `std` of observations, its `limit`."""
    arrays = {"kind": Actor.__name__, **_layer_arrays(policy.layers), "mean": policy.mean, "std": policy.std,
              "limit": policy.limit}  # fmt: skip
    save_arrays(path, {name: np.asarray(array) for name, array in arrays.items()})


def load_policy(path: Path) -> Actor:
    """The policy that `save_policy` wrote, bit for bit, its arrays numpy's; SimgapError when the file holds none."""
    arrays = load_arrays(path)
    kind = str(arrays.pop("kind", "none"))
    try:
        if kind != Actor.__name__:
            raise ValueError(f"its kind is {kind[:_KIND_SHOWN]!r}")
        return Actor(_pop_layers(arrays), **arrays)  # type: ignore[arg-type]  # numpy's arrays serve as jax's
    except (KeyError, TypeError, ValueError) as error:
        raise SimgapError(f"{path}: holds no policy of this version ({error}). Run the stage `policy`.") from None


def _layer_arrays(layers: Sequence[tuple[Array, Array]]) -> dict[str, Array]:
    return {
        f"{part}_{i}": array
        for i, layer in enumerate(layers)
        for part, array in zip(("weight", "bias"), layer, strict=True)
    }


def _pop_layers(arrays: dict[str, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """The layers among `arrays`, at least one, which are taken out; KeyError if one is missing."""
    count = max(1, sum(name.startswith("weight_") for name in arrays))
    return [(arrays.pop(f"weight_{i}"), arrays.pop(f"bias_{i}")) for i in range(count)]


def _augmented_spot(simulator: object) -> AugmentedSimulator:
    if isinstance(simulator, AugmentedSimulator) and type(simulator.simulator) is Spot:
        return simulator
    raise SimgapError(f"a model of {simulator} cannot be written; it must be one of a Spot with diagnosed effects.")
