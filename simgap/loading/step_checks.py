"""Checks a step: its shape, that it repeats, and that JAX can trace and differentiate it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.loading.user_code import RAISED, reason, shown
from simgap.types import ConfigError, StepModel

_TYPICAL = {"position": 0.3, "angle": 0.3, "velocity": 0.2, "force": 1.0}
_POINTS = ("all states and commands zero", "typical states and commands")


class _Trial(NamedTuple):
    """Where a step is tried: nominal parameters; all states and commands zero, and typical ones."""

    params: Float[Array, " p"]
    states: Float[Array, "2 s"]
    commands: Float[Array, "2 u"]


def check_step(simulator: StepModel, name: str) -> None:
    """ConfigError that begins with `name` unless the step repeats, is finite, and can be traced and differentiated."""
    # Checks that compile come last, as most mistakes show without.
    trial = _trial(simulator)
    first = _outputs(simulator, trial, name)
    # All points again in the same order: if a step remembers one point, it shows at the other.
    if not np.array_equal(first, _outputs(simulator, trial, name), equal_nan=True):
        raise ConfigError(
            f"{name}: step must give the same next state for the same input; a second call gave another. Keep what it "
            "remembers in the state, and leave random numbers out: noise is estimated from the recordings."
        )
    _check_traceable(simulator, trial, name)
    for values, point in zip(first, _POINTS, strict=True):
        bad = [f.name for f, v in zip(simulator.schema.state, values, strict=True) if not np.isfinite(v)]
        if bad:
            raise ConfigError(
                f"{name}: step must return finite numbers; at nominal parameters and {point} {', '.join(bad)} is not. "
                "Look for a division by zero or a root of a negative number; choose its argument with jnp.where."
            )
    _check_differentiable(simulator, trial, name)


def _trial(simulator: StepModel) -> _Trial:
    params = [(p.low + p.high) / 2 if p.nominal is None else p.nominal for p in simulator.parameters]
    states, commands = (
        # All values differ: a hand exactly at its base would have no direction.
        jnp.array([[_TYPICAL[f.kind] * (1 + 0.1 * i) * scale for i, f in enumerate(fields)] for scale in (0, 1)])
        for fields in (simulator.schema.state, simulator.schema.command)
    )
    return _Trial(jnp.array(params, float), states, commands)


def _outputs(simulator: StepModel, trial: _Trial, name: str) -> Float[np.ndarray, "2 s"]:
    """The next states, of the right shape."""
    params, states, commands = trial
    try:
        outputs = [simulator.step(params, s, u) for s, u in zip(states, commands, strict=True)]
    except RAISED as error:
        raise ConfigError(
            f"{name}: step must run on arrays of {len(params)} parameters, {states.shape[1]} states and "
            f"{commands.shape[1]} commands; at nominal parameters it gave {reason(error)}. Mend the step."
        ) from None
    for output in outputs:
        shape = getattr(output, "shape", None)
        if shape != states[0].shape:
            raise ConfigError(
                f"{name}: step must return the next state, one array of shape {states[0].shape}; it returned "
                f"{shown(output) if shape is None else f'shape {shape}'}. Return jnp.stack([...]) of one number per "
                "Field of schema.state, in its order."
            )
    return np.stack([np.asarray(output) for output in outputs])


def _check_traceable(simulator: StepModel, trial: _Trial, name: str) -> None:
    params, states, commands = trial
    try:
        traced = jax.eval_shape(simulator.step, params, states[0], commands[0])
        jax.eval_shape(jax.vmap(simulator.step, (None, 0, 0)), params, states, commands)
    except RAISED as error:
        raise ConfigError(
            f"{name}: jax.jit and jax.vmap must be able to trace step; that gave {reason(error)}. Use jax.numpy "
            "instead of numpy and math, and jnp.where instead of `if` on values."
        ) from None
    if traced.dtype != states.dtype:
        raise ConfigError(
            f"{name}: step must return an array of dtype {states.dtype}, as its inputs have; it returned "
            f"{traced.dtype}. Compute the next state from the state, without converting it."
        )


def _check_differentiable(simulator: StepModel, trial: _Trial, name: str) -> None:
    def slopes(*point: Array) -> list[Array]:
        # One argument at a time: together, one infinite derivative would make all of them nan.
        return [jax.jacfwd(simulator.step, argument)(*point) for argument in (1, 2, 0)]

    try:
        jacobians = jax.jit(jax.vmap(slopes, (None, 0, 0)))(*trial)
    except RAISED as error:
        raise ConfigError(
            f"{name}: jax.jacfwd must be able to differentiate step; that gave {reason(error)}. Use operations of "
            "jax.numpy, without callbacks to Python and without custom_vjp."
        ) from None
    schema = simulator.schema
    for inputs, jacobian in zip((schema.state, schema.command, simulator.parameters), jacobians, strict=True):
        bad = np.argwhere(~np.isfinite(np.asarray(jacobian)))
        if len(bad):
            point, output, column = bad[0]
            raise ConfigError(
                f"{name}: step must be differentiable at nominal parameters; at {_POINTS[point]} the derivative of "
                f"{schema.state[output].name} by {inputs[column].name} is {jacobian[point, output, column]}. Look for "
                "sqrt, a norm, arctan2, a power or a division at zero: add a small number under the root, and choose "
                "the argument (not the result) with jnp.where."
            )
