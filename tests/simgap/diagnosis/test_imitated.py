"""What the parameters of a simulator imitate is no gap of it, and no reason to record more."""

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from jaxtyping import Array, Float

import simgap
from simgap.types import Field, Parameter, Schema

pytestmark = pytest.mark.long

STEP = 0.05


class Cart:
    """A cart that a force drives against a drag."""

    time_step = STEP
    schema = Schema(
        state=(
            Field("x", "m", "position", "world", "cart", "x"),
            Field("v", "m/s", "velocity", "world", "cart", "x"),
        ),
        command=(Field("force", "N", "force", "world", "cart", "x"),),
    )
    parameters: tuple[Parameter, ...] = (Parameter("drag", "N s/m", 0.1, 4.0, nominal=1.0),)

    def step(self, params: Float[Array, " p"], state: Float[Array, " 2"], command: Float[Array, " 1"]) -> Array:
        drag, mass = (params[0], params[1]) if len(self.parameters) > 1 else (params[0], 1.0)
        decay = jnp.exp(-drag / mass * STEP)
        after = command[0] / drag + (state[1] - command[0] / drag) * decay
        return jnp.stack([state[0] + STEP * (state[1] + after) / 2, after])


class CartOfUnknownMass(Cart):
    """The same; a gain of its force would look like another mass and another drag."""

    parameters = (*Cart.parameters, Parameter("mass", "kg", 0.3, 3.0, nominal=1.2))


def recorded(push: float) -> list[pd.DataFrame]:
    """Sessions of a cart of 1 kg with a force that is `push` times the one sent."""
    sessions = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        force = np.repeat(rng.uniform(-3, 3, 20), 10)
        x, v = np.zeros(200), np.zeros(200)
        for t in range(199):
            after = push * force[t] + (v[t] - push * force[t]) * np.exp(-STEP)
            x[t + 1], v[t + 1] = x[t] + STEP * (v[t] + after) / 2, after
        noisy = {"x": x + rng.normal(0, 2e-3, 200), "v": v + rng.normal(0, 1e-2, 200)}
        sessions.append(pd.DataFrame({"time_s": STEP * np.arange(200), **noisy, "force": force}))
    return sessions


def test_a_gain_that_looks_like_another_mass_is_a_matter_of_parameters() -> None:
    """A simulator with another mass and drag describes a cart with a stronger motor as well."""
    said = simgap.diagnose(CartOfUnknownMass(), recorded(1.3)).statement
    assert set(said["sensitivity"]["imitated_effects"]) == {"gain", "viscous_drag"}
    assert not any(e["id"] in ("gain", "viscous_drag") for e in said["found"])
    assert said["verdict"] == "parameters_only"
    assert "Gain and viscous drag would look like other values of the parameters." in said["statement"]
    assert all(v["size"] is None for v in said["sensitivity"]["effects"] if v["effect"] in ("gain", "viscous_drag"))


def test_where_no_parameter_imitates_a_gain_it_would_have_been_found() -> None:
    said = simgap.diagnose(Cart(), recorded(1.0)).statement
    assert said["sensitivity"]["imitated_effects"] == ["viscous_drag"]
    assert [v["size"] for v in said["sensitivity"]["effects"] if v["effect"] == "gain"] != [None]
