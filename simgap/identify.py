"""SIM-MODEL: a simulator's parameters fitted to transitions, with a noise [Hoffman et al. 2025, Baseline Models]."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from simgap.noise import NoiseFamily
from simgap.simulators import parameter_ranges, state_difference
from simgap.types import ConfigError, DivergenceError, Report, Simulator


@dataclass(frozen=True)
class Config:
    """Hyperparameters of the fit [Hoffman et al. 2025, Table 1, Sim-MODEL]; `evaluate_every` is in steps."""

    training_steps: int
    learning_rate: float
    weight_decay: float
    evaluate_every: int

    def __post_init__(self) -> None:
        for name in ("training_steps", "learning_rate", "evaluate_every"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be above 0.")


def _physical(simulator: Simulator, z: Float[Array, " p"]) -> Float[Array, " p"]:
    """Parameters from coordinates in which every plausible range is [-1, 1], so that one learning rate suits all."""
    low, high = map(jnp.asarray, parameter_ranges(simulator))
    return (high + low) / 2 + (high - low) / 2 * z


def _optimiser(config: Config) -> optax.GradientTransformation:
    # Decay pulls the parameters to the middle of their ranges and leaves the noise alone.
    return optax.adamw(config.learning_rate, weight_decay=config.weight_decay, mask={"z": True, "noise": False})


@partial(jax.jit, static_argnames=("simulator", "steps", "config", "noise"))
def _run(
    carry: tuple[dict[str, Any], Any],
    data: tuple[Float[Array, "n x"], Float[Array, "n y"]],
    y_std: Float[Array, " y"],
    simulator: Simulator,
    steps: int,
    config: Config,
    noise: NoiseFamily,
) -> tuple[tuple[dict[str, Any], Any], Float[Array, ""]]:
    x, y = data

    def loss(variables: dict[str, Any]) -> Float[Array, ""]:
        params = _physical(simulator, variables["z"])
        predicted = jax.vmap(lambda x: state_difference(simulator, params, x))(x)
        return -noise.log_density(variables["noise"], (y - predicted) / y_std).sum(-1).mean()

    def body(carry: tuple[dict[str, Any], Any], _: None) -> tuple[tuple[dict[str, Any], Any], Float[Array, ""]]:
        variables, state = carry
        value, gradient = jax.value_and_grad(loss)(variables)
        updates, state = _optimiser(config).update(gradient, state, variables)
        updated: Any = optax.apply_updates(variables, updates)
        return (updated, state), value

    carry, losses = jax.lax.scan(body, carry, length=steps)
    return carry, losses[-1] + jnp.log(y_std).sum()


def identify(
    simulator: Simulator,
    data: tuple[Float[Array, "n x"], Float[Array, "n y"]],
    config: Config,
    noise: NoiseFamily,
    report: Report,
) -> tuple[Float[Array, " p"], Float[Array, " y"], Float[Array, " y"]]:
    """Parameters, noise scale [original units] and degrees of freedom of greatest likelihood given one-step data.

    Full-batch Adam from the middle of the plausible ranges; nothing keeps the parameters inside them. `report` gets
    train_nll, in original units.

    Raises DivergenceError when the NLL leaves the finite numbers.
    """
    y_std = jnp.where(data[1].std(0) > 0, data[1].std(0), 1.0)
    variables = {"z": jnp.zeros(len(simulator.parameters)), "noise": noise.init(data[1].shape[1])}
    carry = (variables, _optimiser(config).init(variables))
    for done in range(config.evaluate_every, config.training_steps + 1, config.evaluate_every):
        carry, nll = _run(carry, data, y_std, simulator, config.evaluate_every, config, noise)
        report(done, {"train_nll": float(nll)})
        if not jnp.isfinite(nll):
            raise DivergenceError(f"the fit diverged within the steps up to {done}: NLL {nll}. Lower learning_rate.")
    variables = carry[0]
    scale = noise.scale(variables["noise"]) * y_std
    return _physical(simulator, variables["z"]), scale, noise.dof(variables["noise"])
