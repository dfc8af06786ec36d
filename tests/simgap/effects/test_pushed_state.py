"""How a push enters a simulator that no command drives along its axis."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from simgap.effects.augmented import Augmented
from simgap.effects.stepping import Given, pushed_state
from simgap.types import Field, Parameter, Schema

STEP = 0.1


class Thrown:
    """A body in free flight; `moved` gives how far it goes in a step with its velocities before and after it."""

    time_step = STEP
    schema = Schema(
        state=(
            Field("z", "m", "position", "world", "body", "z"),
            Field("vz", "m/s", "velocity", "world", "body", "z"),
        ),
        command=(),
    )
    parameters = (Parameter("weight", "m/s^2", 5.0, 15.0, nominal=9.81),)

    def __init__(self, moved: Callable[[Array, Array], Array]) -> None:
        self.moved = moved

    def step(self, params: Float[Array, " 1"], state: Float[Array, " 2"], command: Float[Array, " 0"]) -> Array:
        del command
        z, v = state
        after = v - STEP * params[0]
        return jnp.stack([z + STEP * self.moved(v, after), after])


@pytest.mark.parametrize(
    "moved", [lambda v, after: (v + after) / 2, lambda v, _: v, lambda _, after: after], ids=["mean", "before", "after"]
)
def test_a_constant_push_moves_a_body_along_a_parabola(moved: Callable[[Array, Array], Array]) -> None:
    """Relative to its path without the push, however the simulator gets from velocities to positions."""
    push, steps = 0.3, 40
    augmented = Augmented(Thrown(moved))
    given = Given(jnp.array([9.81]), jnp.zeros(0), None, None)
    free = pushed = jnp.array([0.0, 4.0])
    for _ in range(steps):
        free, _ = pushed_state(augmented, free, given, jnp.zeros(1), jnp.zeros((1, 4)))
        pushed, rates = pushed_state(augmented, pushed, given, jnp.zeros(1), jnp.array([[0.0, 0.0, push, 0.0]]))
        assert not np.asarray(rates).any()
    np.testing.assert_allclose(pushed - free, [push * STEP * steps**2 / 2, push * steps], rtol=1e-5)
