"""The simulator's parameters, the durations of rows and the noise, fitted together to single transitions."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float, PRNGKeyArray

from simgap.noise import NoiseFamily
from simgap.residual import duration
from simgap.residual.config import Config
from simgap.simulators import parameter_ranges
from simgap.types import DivergenceError, Report, Simulator


class Fitted(NamedTuple):
    """Parameters of the simulator, durations [steps], and the noise's parameters, in units of `y_std`."""

    params: Float[Array, " p"]
    durations: Float[Array, " q"]
    noise: dict[str, Array]
    y_std: Float[Array, " y"]


def log_density(
    residuals: Float[Array, "... q y"],
    noise_params: dict[str, Array],
    noise: NoiseFamily,
    logits: Float[Array, " q"] | float = 0.0,
) -> Float[Array, "..."]:
    """ln sum_q w_q prod_i p(r_qi): of a row whose duration nobody knows; residuals in units of `y_std`.

    Durations are equally likely but where their logits differ.
    """
    each = noise.log_density(noise_params, residuals).sum(-1)
    return logsumexp(each + jax.nn.log_softmax(jnp.zeros(each.shape[-1]) + logits), axis=-1)


def equally_likely(durations: Float[Array, " q"], logits: Float[Array, " q"]) -> Float[Array, " q"]:
    """As many durations that are equally likely: the law's quantiles at the middles of as many equal shares.

    Two rare durations of similar length so get a share between them; rounded one by one they might get none.
    """
    order = jnp.argsort(durations)
    below = jnp.cumsum(jax.nn.softmax(logits)[order])
    middles = (jnp.arange(len(durations)) + 0.5) / len(durations)
    return durations[order][jnp.clip(jnp.searchsorted(below, middles), 0, len(durations) - 1)]


def fit(
    key: PRNGKeyArray,
    data: tuple[Float[Array, "n x"], Float[Array, "n y"]],
    simulator: Simulator,
    config: Config,
    noise: NoiseFamily,
    report: Report,
) -> Fitted:
    """What is likeliest, by Adam from the middle of the parameters' ranges, from durations about one step.

    `report` gets train_nll, in original units. Raises DivergenceError when it leaves the finite numbers.
    """
    variables = {
        "z": jnp.zeros(len(simulator.parameters)),
        "noise": noise.init(data[1].shape[1]),
        "log_durations": _first(config.durations),
        "logits": jnp.zeros(config.durations),  # a duration that no row has loses its share
    }
    variables, nll = _run(variables, key, data, simulator, config, noise)
    report(config.simulator_steps, {"train_nll": float(nll)})
    if not jnp.isfinite(nll):
        raise DivergenceError(
            f"the fit of the simulator and the durations diverged: NLL {nll}. Lower simulator_learning_rate."
        )
    durations = equally_likely(jnp.exp(variables["log_durations"]), variables["logits"])
    return Fitted(_physical(simulator, variables["z"]), durations, variables["noise"], _deviation(data[1]))


def _deviation(y: Float[Array, "n y"]) -> Float[Array, " y"]:
    """Of the outputs; 1 where one never changes."""
    return jnp.where(y.std(0) > 0, y.std(0), 1.0)


def _first(count: int) -> Float[Array, " q"]:
    """Logarithms of durations near one step, but for a quarter that begin at two to three."""
    near = jnp.log(jnp.linspace(0.7, 1.3, count)) if count > 1 else jnp.zeros(1)
    stalls = count // 4
    return near.at[count - stalls :].set(jnp.log(jnp.linspace(2.0, 3.0, stalls)))


def _physical(simulator: Simulator, z: Float[Array, " p"]) -> Float[Array, " p"]:
    """Parameters from coordinates in which every plausible range is [-1, 1], so that one learning rate suits all."""
    low, high = map(jnp.asarray, parameter_ranges(simulator))
    return (high + low) / 2 + (high - low) / 2 * z


@partial(jax.jit, static_argnames=("simulator", "config", "noise"))
def _run(
    variables: dict[str, Any],
    key: PRNGKeyArray,
    data: tuple[Float[Array, "n x"], Float[Array, "n y"]],
    simulator: Simulator,
    config: Config,
    noise: NoiseFamily,
) -> tuple[dict[str, Any], Float[Array, ""]]:
    (x, y), y_std = data, _deviation(data[1])
    optimiser = optax.adam(optax.cosine_decay_schedule(config.simulator_learning_rate, config.simulator_steps))

    def loss(variables: dict[str, Any], rows: Array) -> Float[Array, ""]:
        params, durations = _physical(simulator, variables["z"]), jnp.exp(variables["log_durations"])
        predicted = jax.vmap(lambda x: duration.after(duration.path(simulator, params, x), durations))(x[rows])
        residuals = (y[rows, None] - predicted) / y_std
        return -log_density(residuals, variables["noise"], noise, variables["logits"]).mean()

    def body(carry: tuple[Any, Any], key: Array) -> tuple[tuple[Any, Any], Float[Array, ""]]:
        variables, state = carry
        rows = jax.random.randint(key, (min(config.simulator_batch, len(x)),), 0, len(x))
        value, gradient = jax.value_and_grad(loss)(variables, rows)
        updates, state = optimiser.update(gradient, state, variables)
        return (optax.apply_updates(variables, updates), state), value

    keys = jax.random.split(key, config.simulator_steps)
    (variables, _), losses = jax.lax.scan(body, (variables, optimiser.init(variables)), keys)
    return variables, losses[-max(1, config.simulator_steps // 20) :].mean() + jnp.log(y_std).sum()
