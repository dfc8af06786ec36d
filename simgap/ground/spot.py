"""A legged base with an arm as a machine of the training ground: simulated by the paper's kinematic model.

Laws act on velocities in the robot's own frame, the hand's relative to the base. The model is given the command that
changes its velocities as the laws do in a row. So a machine without laws does what its simulator does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Array, Float

from simgap.ground.laws import Law
from simgap.ground.machine import Machine
from simgap.simulators.spot import Spot

FINER = 20
"""Steps of the laws in a row: with fewer, strong dry friction throws the base to and fro while it stands."""
USUAL = np.array([0.5, 0.5, 0.7, 0.35, 0.35, 0.25])
"""Usual commands and speeds [m/s, m/s, rad/s, m/s, m/s, m/s]."""
HOME = np.array([0.85, 0.0, 0.6])
"""Where the hand is at first, from the base's origin on the floor [m]."""
RETURN = 0.8
"""Rate at which commands bring the hand back home [1/s]."""
UNEVEN = 0.03
"""How much the positions' steps per velocity differ among the axes, at most, as a share."""
_step = jax.jit(Spot().step)


@dataclass(frozen=True)
class LeggedMachine(Machine):
    """See the module."""

    @property
    def start(self) -> Float[np.ndarray, " 12"]:
        """See `Machine`."""
        return np.concatenate([np.zeros(6), HOME, np.zeros(3)])

    @property
    def sizes(self) -> tuple[float, float]:
        """See `Machine`; twelve outputs show smaller ones than two do."""
        return 0.005, 0.15

    @property
    def usual(self) -> Float[np.ndarray, " 6"]:
        """See `Machine`."""
        return USUAL

    def drawn(self, rng: np.random.Generator) -> Float[np.ndarray, " 24"]:
        """See `Machine`; the axes' clocks are alike, as positions of base and hand come from the same one."""
        params = super().drawn(rng)
        params[18:] = params[18] * rng.uniform(1 - UNEVEN, 1 + UNEVEN, 6)
        return params

    def sent(self, drawn: Float[np.ndarray, " 6"], state: Float[np.ndarray, " 12"]) -> Float[np.ndarray, " 6"]:
        """See `Machine`; the hand's command also leads it home, as an operator would."""
        away = _own_frame(state)[:3] - HOME
        return USUAL * drawn - np.concatenate([np.zeros(3), np.clip(RETURN * away, -USUAL[3:], USUAL[3:])])

    def step(
        self, params: Float[Array, " 24"], state: Float[Array, " 12"], command: Float[Array, " 6"]
    ) -> Float[Array, " 12"]:
        """See `Machine`."""
        return Spot().step(params, state, command)

    def row(
        self,
        params: Float[np.ndarray, " 24"],
        state: Float[np.ndarray, " 12"],
        sent: Float[np.ndarray, " 6"],
        laws: Sequence[Law],
    ) -> Float[np.ndarray, " 12"]:
        """See `Machine`."""
        kept, h = params[:6] ** (1 / FINER), self.time_step / FINER
        own = _own_frame(state)
        q, plain = np.concatenate([state[:3], own[:3] - HOME]), own[3:]
        v = plain
        for _ in range(FINER if laws else 0):
            arrives = sent / USUAL
            for law in laws:
                arrives = law.command(arrives, h)
            pushed = sum(law.push(q, v / USUAL, arrives, h) for law in laws)
            v = kept * v + (1 - kept) * USUAL * arrives + h * USUAL * pushed
            plain = kept * plain + (1 - kept) * sent
        with jax.enable_x64(True):
            return np.array(_step(params, state, sent + (v - plain) / (1 - params[:6])))

    def rate(self, params: Float[np.ndarray, " 24"]) -> float:
        """See `Machine`; on average over the axes."""
        return float((1 - params[:6] ** (1 / FINER)).mean() * FINER / self.time_step)


def _rotation(yaw: float) -> Float[np.ndarray, "3 3"]:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _own_frame(state: Float[np.ndarray, " 12"]) -> Float[np.ndarray, " 9"]:
    """The hand from the base's origin; the base's velocities, and those of the hand relative to it."""
    back, base, hand = _rotation(state[2]).T, state[3:6], state[9:]
    arm = state[6:9] - [*state[:2], 0.0]
    carried = [base[0] - base[2] * arm[1], base[1] + base[2] * arm[0], 0.0]
    return np.concatenate([back @ arm, back @ base, back @ (hand - carried)])


# A diagnosis of it takes long.
SPOT = LeggedMachine("spot", Spot().schema, Spot().parameters, Spot().time_step, often_long=0.15)
