"""Learnt dynamics and the paper's reward as an environment [Hoffman et al. 2025, Policy Learning]."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from simgap.models import Model, predict
from simgap.policies import reward
from simgap.policies.actor import observation
from simgap.policies.bounds import Bounds, on_course_for
from simgap.recordings import HISTORY, decode_state, encode_state
from simgap.simulators.spot import SCHEMA, from_body, to_body
from simgap.types import ConfigError, Prediction

STARTS = 8
"""Starts that are drawn where not all are allowed, of which the first allowed one counts."""


class Step(NamedTuple):
    """What an action leads to; `lost`: the state left what the environment knows or allows, and nothing is to be had
    there."""

    state: Any
    reward: Float[Array, ""]
    lost: Bool[Array, ""]


class Environment(Protocol):
    """What a policy learns in: pure functions of one state; a pytree, so that one compilation serves many."""

    @property
    def action_size(self) -> int:
        """Number of the action's entries, each in [-1, 1]."""
        ...

    def reset(self, key: PRNGKeyArray) -> Any:
        """A state to begin an episode in."""
        ...

    def observe(self, state: Any) -> Float[Array, " o"]:
        """What the policy sees."""
        ...

    def step(self, state: Any, action: Float[Array, " a"], key: PRNGKeyArray) -> Step:
        """The reward of the action in the state, and the state that follows."""
        ...


@dataclass(frozen=True)
class Config:
    """Of `LearntSpot`.

    reward: the paper's. command_limit: greatest command [m/s, m/s, rad/s, m/s, m/s, m/s], what an action of 1 commands.
    start_motion: share of the box's velocities and commands that an episode begins with [-]; a whole box has corners
    that no recording comes near.
    goal_distance: greatest distance along x and along y between the hand at the start and the goal [m]; goal_height:
    lowest and highest goal above the floor [m]. noise: the predictive noise is drawn, times this [-]; with 0 every
    particle is followed in its mean. escape: an episode is lost once the robot leaves the box of the recordings by this
    factor [-]. stopped: whether it is also lost where a run on the robot would be stopped.
    """

    reward: reward.Config
    command_limit: tuple[float, ...]
    start_motion: float
    goal_distance: float
    goal_height: tuple[float, float]
    noise: float
    escape: float
    stopped: bool

    def __post_init__(self) -> None:
        if len(self.command_limit) != len(SCHEMA.command) or min(self.command_limit) <= 0:
            raise ConfigError(f"command_limit is {self.command_limit}; it must be 6 numbers above 0.")
        if self.goal_height[0] > self.goal_height[1] or self.goal_distance <= 0:
            raise ConfigError("goals must lie at a distance above 0, between a lowest and a highest goal_height.")
        if not 0 <= self.start_motion <= 1:
            raise ConfigError(f"start_motion is {self.start_motion}; it must lie between 0 and 1.")
        if self.noise < 0 or self.escape < 1:
            raise ConfigError(f"noise is {self.noise} and escape {self.escape}; they must be at least 0 and 1.")


class Box(NamedTuple):
    """Least and greatest body coordinates (as `spot.to_body`) and commands that recordings hold."""

    state_low: Float[Array, " 12"]
    state_high: Float[Array, " 12"]
    command_low: Float[Array, " 6"]
    command_high: Float[Array, " 6"]


def box(x: Float[Array, "n 31"]) -> Box:
    """The box that transitions' inputs span."""
    states = jax.vmap(lambda x: to_body(decode_state(SCHEMA, x[: len(SCHEMA.encoded)])))(jnp.asarray(x))
    commands = jnp.asarray(x)[:, -len(SCHEMA.command) :]
    return Box(states.min(0), states.max(0), commands.min(0), commands.max(0))


_VELOCITIES = np.array([field.kind == "velocity" for field in SCHEMA.state])


class Situation(NamedTuple):
    """The robot's state, u_{t-2} and u_{t-1}, the goal; `particle` in [0, 1) says which of the model's is followed."""

    state: Float[Array, " 12"]
    past: Float[Array, "2 6"]
    goal: Float[Array, " 3"]
    particle: Float[Array, ""]


@partial(jax.tree_util.register_dataclass, data_fields=("model", "box"), meta_fields=("config", "bounds"))
@dataclass(frozen=True)
class LearntSpot:
    """A learnt model of the Spot, its hand to be brought to a goal.

    An episode begins uniformly in the box of the recordings, with a goal uniform about the hand. It follows one
    particle, drawn for the episode: what the model does not know stays the same for as long. With `bounds`, it begins
    within them, and is lost where the hand is on course beyond them.
    """

    model: Model
    box: Box
    config: Config
    bounds: Bounds | None = None

    @property
    def action_size(self) -> int:
        """See `Environment`."""
        return len(SCHEMA.command)

    def reset(self, key: PRNGKeyArray) -> Situation:
        """See `Environment`."""
        if self.bounds is None:
            return self._drawn(key)
        drawn = jax.vmap(self._drawn)(jax.random.split(key, STARTS))
        first = jnp.argmax(jax.vmap(self._allowed)(drawn.state))
        return jax.tree.map(lambda a: a[first], drawn)

    def _drawn(self, key: PRNGKeyArray) -> Situation:
        b, far, (lowest, highest) = self.box, self.config.goal_distance, self.config.goal_height
        slow = self.config.start_motion
        share = jnp.concatenate([jnp.where(_VELOCITIES, slow, 1.0), jnp.full(HISTORY * 6, slow), jnp.ones(4)])
        low = jnp.concatenate([b.state_low, b.command_low, b.command_low, jnp.array([-far, -far, lowest, 0.0])])
        high = jnp.concatenate([b.state_high, b.command_high, b.command_high, jnp.array([far, far, highest, 1.0])])
        # Drawn at once: every call of a generator takes its time to compile.
        drawn = jax.random.uniform(key, low.shape, minval=share * low, maxval=share * high)
        state = from_body(drawn[:12])
        goal = state[6:9].at[2].set(0.0) + drawn[24:27]
        return Situation(state, drawn[12:24].reshape(HISTORY, 6), goal, drawn[27])

    def observe(self, state: Situation) -> Float[Array, " 24"]:
        """See `Environment`."""
        return observation(state.state, state.past, state.goal)

    def step(self, state: Situation, action: Float[Array, " 6"], key: PRNGKeyArray) -> Step:
        """See `Environment`; the command takes its place in the history."""
        command = jnp.array(self.config.command_limit) * action
        gained = reward.reward(state.state, state.goal, command, self.config.reward)
        encoded = encode_state(SCHEMA, state.state)
        prediction = predict(self.model, jnp.concatenate([encoded, state.past.reshape(-1), command]))
        mean = prediction.mean[jnp.int32(state.particle * len(prediction.mean))]
        change = mean + self.config.noise * draw_noise(key, prediction)
        following = decode_state(SCHEMA, encoded + change)
        lost = ~(self._known(following) & self._allowed(following))
        # A state that means nothing is not passed on: not a number times nothing is not nothing.
        kept = jnp.where(lost, state.state, following)
        past = jnp.concatenate([state.past[1:], command[None]])
        return Step(state._replace(state=kept, past=past), gained, lost)

    def _known(self, state: Float[Array, " 12"]) -> Bool[Array, ""]:
        """Whether the state lies in the box, enlarged by `escape`; NaN does not."""
        low, high = self.box.state_low, self.box.state_high
        middle, half = (low + high) / 2, (high - low) / 2
        return jnp.all(jnp.abs(to_body(state) - middle) <= self.config.escape * jnp.maximum(half, 1e-3))

    def _allowed(self, state: Float[Array, " 12"]) -> Bool[Array, ""]:
        """Whether a run on the robot would go on."""
        return jnp.array(True) if self.bounds is None else ~on_course_for(state, self.bounds).any()


def draw_noise(key: PRNGKeyArray, prediction: Prediction) -> Float[Array, " y"]:
    """The predictive noise: Student's t, normal where the degrees of freedom nu are infinite.

    scale sqrt(nu (U^{-2/nu} - 1)) cos(2 pi V) with U, V uniform in (0, 1) [Bailey 1994], whose limit is Box and
    Muller's sqrt(-2 ln U) cos(2 pi V).
    """
    u, v = jax.random.uniform(key, (2, *prediction.scale.shape), minval=jnp.finfo(jnp.float32).tiny)
    gaussian = jnp.isinf(prediction.dof)
    dof = jnp.where(gaussian, 1.0, prediction.dof)
    squared = jnp.where(gaussian, -2 * jnp.log(u), dof * jnp.expm1(-2 / dof * jnp.log(u)))
    return prediction.scale * jnp.sqrt(squared) * jnp.cos(2 * jnp.pi * v)
