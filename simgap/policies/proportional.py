"""What a policy is compared with: proportional control that takes commands to act at once."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.simulators.spot import induced_velocity, rotation, to_body


class Proportional(NamedTuple):
    """Base and arm each close their distance at a rate in proportion to it; delays and lags are ignored.

    gain: of the hand [1/s]. base_gain: of the base [1/s], which brings the goal to where the hand rests. rest: that
    place in the base's frame [m].
    """

    gain: Float[Array, ""]
    base_gain: Float[Array, ""]
    rest: Float[Array, " 3"]

    def command(
        self,
        state: Float[Array, " 12"],
        past: Float[Array, "2 6"],  # noqa: ARG002  # ignoring them is what it is for
        goal: Float[Array, " 3"],
    ) -> Float[Array, " 6"]:
        """See `simgap.types.Policy`."""
        hand = to_body(state)[6:9]
        to_goal = rotation(state[2]).T @ (goal - state[6:9])
        wanted = hand + to_goal - self.rest
        turn = jnp.arctan2(hand[1] + to_goal[1], hand[0] + to_goal[0])
        u_base = self.base_gain * wanted.at[2].set(turn)
        # The hand is carried along by the base: what that adds is taken off.
        carried = u_base.at[2].set(0.0) + induced_velocity(u_base[2], hand)
        return jnp.concatenate([u_base, self.gain * to_goal - carried])
