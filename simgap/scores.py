"""How good a dynamics model is on sessions that took no part in its training."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import betainc, logsumexp
from jax.scipy.stats import norm
from jaxtyping import Array, Float

from simgap.models import mean
from simgap.noise import gaussian_log_density, student_t_log_density
from simgap.prediction import Model, predict, steady
from simgap.recordings import HISTORY, decode_state, encode_state
from simgap.types import Prediction, Recording, Schema, Transitions

LEVELS = np.linspace(0.05, 0.95, 19)
"""Probabilities at which calibration is read off."""


def joint_log_density(prediction: Prediction, y: Float[Array, " y"]) -> Float[Array, ""]:
    """ln p(y | x) of all outputs jointly under the predictive mixture, in original units."""
    residual = y - prediction.mean
    gaussian = jnp.isinf(prediction.dof)
    dof = jnp.where(gaussian, 1.0, prediction.dof)  # any finite number: keeps the branch not taken free of NaN
    density = jnp.where(
        gaussian,
        gaussian_log_density(residual, prediction.scale),
        student_t_log_density(residual, prediction.scale, dof),
    )
    return logsumexp(density.sum(-1)) - jnp.log(len(prediction.mean))


def student_t_cdf(z: Float[Array, "..."], dof: Float[Array, "..."]) -> Float[Array, "..."]:
    """Distribution function of Student's t, through the incomplete beta function."""
    tail = 0.5 * betainc(dof / 2, 0.5, dof / (dof + z**2))
    return jnp.where(z > 0, 1 - tail, tail)


def cumulative(prediction: Prediction, y: Float[Array, " y"]) -> Float[Array, " y"]:
    """P(Y_i <= y_i | x) per output under the predictive mixture; uniform where the model is calibrated."""
    z = (y - prediction.mean) / prediction.scale
    gaussian = jnp.isinf(prediction.dof)
    dof = jnp.where(gaussian, 1.0, prediction.dof)
    return jnp.where(gaussian, norm.cdf(z), student_t_cdf(z, dof)).mean(0)


def calibration_error(probabilities: Float[np.ndarray, "n y"]) -> float:
    """Mean over outputs and `LEVELS` p of |share of points with P(Y <= y) <= p, less p|; 0 is perfect."""
    share = (probabilities[None] <= LEVELS[:, None, None]).mean(1)
    return float(np.abs(share - LEVELS[:, None]).mean())


@jax.jit
def _one_step(model: Model, x: Array, y: Array) -> tuple[Array, Array, Array]:
    def at(x: Array, y: Array) -> tuple[Array, Array, Array]:
        prediction = predict(model, x)
        return -joint_log_density(prediction, y), y - mean(prediction), cumulative(prediction, y)

    return jax.vmap(at)(x, y)


def one_step(model: Model, test: Transitions, outputs: Sequence[str]) -> dict[str, float]:
    """NLL (mean and median over points), RMSE per output (original units), calibration error.

    The NLL is -ln p(y | x), jointly over the outputs, under the predictive mixture, in original units.
    """
    nll, residual, probabilities = (np.asarray(a) for a in _one_step(model, test.x, test.y))
    rmse = np.sqrt(np.mean(residual**2, axis=0))
    return {
        "nll": float(nll.mean()),
        "nll_median": float(np.median(nll)),
        "nll_worst": float(nll.max()),
        "calibration_error": calibration_error(probabilities),
        **{f"rmse_{name}": float(value) for name, value in zip(outputs, rmse, strict=True)},
    }


def rollout(
    model: Model, schema: Schema, state: Float[Array, " s"], commands: Float[Array, "h u"]
) -> Float[Array, "t L s"]:
    """Predicted states for t = h - HISTORY steps, a trajectory per particle, each fed with its own mean predictions.

    `commands` are those sent, from HISTORY rows before the start on.
    """
    particles = steady(model, jnp.zeros(len(schema.encoded) + (HISTORY + 1) * commands.shape[1])).shape[0]
    history = jnp.stack([commands[k : len(commands) - HISTORY + k] for k in range(HISTORY + 1)], axis=1)

    def advance(l: Array, state: Array, u: Array) -> tuple[Array, Array]:  # noqa: E741
        encoded = encode_state(schema, state)
        change = steady(model, jnp.concatenate([encoded, u.reshape(-1)]))[l]
        state = decode_state(schema, encoded + change)
        return state, state

    trajectories = jax.vmap(lambda l: jax.lax.scan(partial(advance, l), state, history)[1])(jnp.arange(particles))  # noqa: E741
    return jnp.swapaxes(trajectories, 0, 1)


@partial(jax.jit, static_argnames=("schema", "horizons"))
def _rollout_errors(
    model: Model, schema: Schema, states: Array, commands: Array, later: Array, horizons: tuple[int, ...]
) -> Array:
    def one(state: Array, commands: Array, later: Array) -> Array:
        predicted = rollout(model, schema, state, commands).mean(1)
        return (predicted - later)[jnp.array(horizons) - 1]

    return jax.vmap(one)(states, commands, later)


def multi_step(
    model: Model, schema: Schema, recordings: Sequence[Recording], horizons: tuple[int, ...], stride: int
) -> dict[str, float]:
    """Mean distance [m] between predicted and measured base and end-effector after `horizons` steps of rollout.

    Every `stride`-th row of the sessions that has its history before it and the longest horizon after it is a start;
    the prediction is the mean of the particles' trajectories. Sessions too short for one start are passed over; NaN
    where none is long enough.
    """
    longest = max(horizons)
    states, commands, later = [], [], []
    for recording in recordings:
        for t in range(HISTORY, len(recording.state) - longest, stride):
            states.append(recording.state[t])
            commands.append(recording.command[t - HISTORY : t + longest])
            later.append(recording.state[t + 1 : t + 1 + longest])
    names = [field.name for field in schema.state]
    errors = np.full((1, len(horizons), len(names)), np.nan)
    if states:
        arrays = (jnp.asarray(np.stack(a), jnp.float32) for a in (states, commands, later))
        errors = np.asarray(_rollout_errors(model, schema, *arrays, horizons=horizons))
    scores = {}
    for body, axes in (("base", ("base_x", "base_y")), ("ee", ("ee_x", "ee_y", "ee_z"))):
        distance = np.linalg.norm(errors[..., [names.index(a) for a in axes]], axis=-1).mean(0)
        scores |= {f"rollout_{body}_{h}": float(d) for h, d in zip(horizons, distance, strict=True)}
    return scores
