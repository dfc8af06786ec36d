"""The paper's reward for a hand that is to be at a goal [Hoffman et al. 2025, Policy Learning]."""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.types import ConfigError


@dataclass(frozen=True)
class Config:
    """The reward's numbers, named as in [Hoffman et al. 2025, Table 1].

    `state_bound` b, `state_margin` m [m] and `state_value` a [-] of r_state; `arm_length` l_arm, `arm_margin` m [m] and
    `arm_value` a [-] of r_ee-base; `base_cost` lambda_base and `ee_cost` lambda_ee [1/(m/s)^2] of r_action;
    `state_weight`, `arm_weight`, `action_weight`: w_1, w_2, w_3.
    """

    state_bound: float
    state_margin: float
    state_value: float
    arm_length: float
    arm_margin: float
    arm_value: float
    base_cost: float
    ee_cost: float
    state_weight: float
    arm_weight: float
    action_weight: float

    def __post_init__(self) -> None:
        for name in ("state_margin", "arm_margin"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be above 0.")
        for name in ("state_value", "arm_value"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must lie between 0 and 1.")


def long_tailed_sigmoid(x: Float[Array, ""], margin: float, value: float) -> Float[Array, ""]:
    """sigma_{m,a}(x) = 1 / ((x / m sqrt(1/a - 1))^2 + 1): 1 at x = 0, a at x = m."""
    return 1 / ((x / margin) ** 2 * (1 / value - 1) + 1)


def within(distance: Float[Array, ""], bound: float, margin: float, value: float) -> Float[Array, ""]:
    """1 where the distance [m] is at most `bound`; beyond it sigma_{m,a}(distance - bound)."""
    return long_tailed_sigmoid(jnp.maximum(distance - bound, 0.0), margin, value)


def r_state(p_ee: Float[Array, " 3"], goal: Float[Array, " 3"], config: Config) -> Float[Array, ""]:
    """How near the hand is to its goal [m], from 0 to 1."""
    return within(jnp.linalg.norm(p_ee - goal), config.state_bound, config.state_margin, config.state_value)


def r_ee_base(p_ee: Float[Array, " 3"], p_base: Float[Array, " 3"], config: Config) -> Float[Array, ""]:
    """How well the hand is within the arm's length of the base [m], from 0 to 1.

    The base's position is planar: its yaw, third in `p_base`, is none, and its point lies on the floor, where the
    kinematic model has it too.
    """
    distance = jnp.linalg.norm(p_ee - p_base.at[2].set(0.0))
    return within(distance, config.arm_length, config.arm_margin, config.arm_value)


def r_action(command: Float[Array, " 6"], config: Config) -> Float[Array, ""]:
    """-(lambda_base |u_base|^2 + lambda_ee |u_ee|^2), commands in m/s and rad/s."""
    return -(config.base_cost * jnp.sum(command[:3] ** 2) + config.ee_cost * jnp.sum(command[3:] ** 2))


def reward(
    state: Float[Array, " 12"], goal: Float[Array, " 3"], command: Float[Array, " 6"], config: Config
) -> Float[Array, ""]:
    """r(s_cond, u) = w_1 r_state + w_2 r_ee-base + w_3 r_action; the state in the columns of `spot.SCHEMA`."""
    p_base, p_ee = state[:3], state[6:9]
    return (
        config.state_weight * r_state(p_ee, goal, config)
        + config.arm_weight * r_ee_base(p_ee, p_base, config)
        + config.action_weight * r_action(command, config)
    )
