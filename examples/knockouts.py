"""Simulators of Spot with a known part taken out: from recordings of a robot, a diagnosis must name that part.

`simgap diagnose RECORDINGS --simulator examples.knockouts:WITHOUT_INDUCED_VELOCITY`
"""

from dataclasses import dataclass

from jaxtyping import Array, Float

from simgap.simulators.spot import Spot, induced_velocity


@dataclass(frozen=True)
class WithoutInducedVelocity(Spot):
    """The kinematic model with v^ind = 0: turning the base does not carry the hand along."""

    def step(
        self, params: Float[Array, " 24"], state: Float[Array, " 12"], command: Float[Array, " 6"]
    ) -> Float[Array, " 12"]:
        """The next state, less what turning adds to the hand's velocity and so to its position."""
        then = super().step(params, state, command)
        arm = state[6:9].at[:2].add(-state[:2])
        v_ind = induced_velocity(then[5], arm)
        return then.at[9:].add(-v_ind).at[6:9].add(-self.time_step * params[21:] * v_ind)


WITHOUT_INDUCED_VELOCITY = WithoutInducedVelocity()
