"""The paper's kinematic model of a Boston Dynamics Spot with arm, line by line [Hoffman et al. 2025, Kinematic Model].

State s = [p_base, v_base, p_ee, v_ee] in R^12, world frame; command u = [u_base, u_ee] in R^6, body frame.
Parameters phi = [alpha, beta, gamma] in R^24.
"""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.types import Field, Parameter, Schema

SCHEMA = Schema(
    state=(
        Field("base_x", "m", "position", "world", "base", "x"),
        Field("base_y", "m", "position", "world", "base", "y"),
        Field("base_yaw", "rad", "angle", "world", "base", "yaw"),
        Field("base_vx", "m/s", "velocity", "world", "base", "x"),
        Field("base_vy", "m/s", "velocity", "world", "base", "y"),
        Field("base_wz", "rad/s", "velocity", "world", "base", "yaw"),
        Field("ee_x", "m", "position", "world", "ee", "x"),
        Field("ee_y", "m", "position", "world", "ee", "y"),
        Field("ee_z", "m", "position", "world", "ee", "z"),
        Field("ee_vx", "m/s", "velocity", "world", "ee", "x"),
        Field("ee_vy", "m/s", "velocity", "world", "ee", "y"),
        Field("ee_vz", "m/s", "velocity", "world", "ee", "z"),
    ),
    command=(
        Field("cmd_base_vx", "m/s", "velocity", "body", "base", "x"),
        Field("cmd_base_vy", "m/s", "velocity", "body", "base", "y"),
        Field("cmd_base_wz", "rad/s", "velocity", "body", "base", "yaw"),
        Field("cmd_ee_vx", "m/s", "velocity", "body", "ee", "x"),
        Field("cmd_ee_vy", "m/s", "velocity", "body", "ee", "y"),
        Field("cmd_ee_vz", "m/s", "velocity", "body", "ee", "z"),
    ),
    mounts=(("ee", "base"),),
)

# The paper estimates plausible ranges heuristically from recordings and prints none. These are the published
# implementation's (github.com/benjirer/simulation_transfer, spot_sim_config.py), but for gamma's upper end: the
# published training sessions advance by 0.10 to 0.16 s of motion a row, 1.5 to 2.4 nominal steps of 1/15 s.
_VELOCITY_UNITS = ("m/s", "m/s", "rad/s", "m/s", "m/s", "m/s")
_POSITION_UNITS = ("m", "m", "rad", "m", "m", "m")
_ALPHA_HIGH = (0.8, 0.8, 0.8, 0.2, 0.2, 0.6)
# beta_1:3 and beta_7:9 shift velocities, beta_4:6 and beta_10:12 shift positions.
_BETA_UNITS = _VELOCITY_UNITS[:3] + _POSITION_UNITS[:3] + _VELOCITY_UNITS[3:] + _POSITION_UNITS[3:]
_BETA_HIGH = (0.003,) * 3 + (0.01,) * 3 + (0.003,) * 3 + (0.01,) * 3
PARAMETERS = (
    *(Parameter(f"alpha_{i + 1}", "-", 0.0, _ALPHA_HIGH[i]) for i in range(6)),
    *(Parameter(f"beta_{i + 1}", _BETA_UNITS[i], -_BETA_HIGH[i], _BETA_HIGH[i]) for i in range(12)),
    *(Parameter(f"gamma_{i + 1}", "-", 0.9, 2.4) for i in range(6)),
)


def rotation(theta: Float[Array, ""]) -> Float[Array, "3 3"]:
    """R(theta), body to world about the vertical axis [Hoffman et al. 2025, eq. 3]."""
    c, s = jnp.cos(theta), jnp.sin(theta)
    return jnp.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def induced_velocity(omega: Float[Array, ""], arm: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """v^ind = [-omega d sin(phi), omega d cos(phi), 0] [Hoffman et al. 2025, Kinematic Model].

    With d and phi the length and direction of the horizontal `arm` [m] from base to end-effector, d sin(phi) and
    d cos(phi) are its y and x: the same number, with a gradient where d = 0.
    """
    return jnp.array([-omega * arm[1], omega * arm[0], 0.0])


def step(
    params: Float[Array, " 24"], state: Float[Array, " 12"], command: Float[Array, " 6"], time_step: float
) -> Float[Array, " 12"]:
    """s_{t+1} = f_kin(s_t, u_t) [Hoffman et al. 2025, eqs. 3-5]; units as in `SCHEMA`, `time_step` [s]."""
    alpha, beta, gamma = params[:6], params[6:18], params[18:]
    p_base, v_base, p_ee, v_ee = state[:3], state[3:6], state[6:9], state[9:]

    # [Hoffman et al. 2025, eq. 3]
    R = rotation(p_base[2])
    u_base, u_ee = R @ command[:3], R @ command[3:]

    # [Hoffman et al. 2025, eq. 4]
    v_base_next = alpha[:3] * v_base + (1 - alpha[:3]) * u_base + beta[:3]
    p_base_next = p_base + time_step * gamma[:3] * v_base_next + beta[3:6]

    # [Hoffman et al. 2025, eq. 5]; D_ee = diag(1, 1, 0)
    arm = p_ee - jnp.array([p_base[0], p_base[1], 0.0])
    v_ind = induced_velocity(v_base_next[2], arm)
    base_motion = jnp.array([v_base_next[0], v_base_next[1], 0.0])
    v_ee_next = alpha[3:] * v_ee + (1 - alpha[3:]) * u_ee + beta[6:9] + base_motion + v_ind
    p_ee_next = p_ee + time_step * gamma[3:] * v_ee_next + beta[9:]

    return jnp.concatenate([p_base_next, v_base_next, p_ee_next, v_ee_next])


def to_body(state: Float[Array, " 12"]) -> Float[Array, " 12"]:
    """The state with velocities turned into the body frame, and the hand's horizontal position from the base."""
    R = rotation(state[2]).T
    hand = R @ (state[6:9] - jnp.array([state[0], state[1], 0.0]))
    return jnp.concatenate([state[:3], R @ state[3:6], hand, R @ state[9:]])


def from_body(body: Float[Array, " 12"]) -> Float[Array, " 12"]:
    """Inverse of `to_body`."""
    R = rotation(body[2])
    hand = R @ body[6:9] + jnp.array([body[0], body[1], 0.0])
    return jnp.concatenate([body[:3], R @ body[3:6], hand, R @ body[9:]])


@dataclass(frozen=True)
class Spot:
    """The kinematic model as a `Simulator`.

    time_step: nominal interval between rows [s].
    """

    time_step: float = 1 / 15
    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = PARAMETERS

    def step(
        self, params: Float[Array, " 24"], state: Float[Array, " 12"], command: Float[Array, " 6"]
    ) -> Float[Array, " 12"]:
        """The next state; see `step`."""
        return step(params, state, command, self.time_step)

    def to_body(self, state: Float[Array, " 12"]) -> Float[Array, " 12"]:
        """See `to_body`."""
        return to_body(state)

    def from_body(self, body: Float[Array, " 12"]) -> Float[Array, " 12"]:
        """See `from_body`."""
        return from_body(body)
