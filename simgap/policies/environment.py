"""Learnt dynamics and the paper's reward as an environment [Hoffman et al. 2025, Policy Learning]."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from simgap.models import Model, predict
from simgap.policies import reward
from simgap.policies.actor import observation
from simgap.recordings import HISTORY, decode_state, encode_state
from simgap.simulators.spot import SCHEMA, from_body, to_body
from simgap.types import Prediction


class Step(NamedTuple):
    """What an action leads to; `lost`: the state left what the environment knows, and nothing is to be had there."""

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
    goal_distance: greatest distance along x and along y between the hand at the start and the goal [m]; goal_height:
    lowest and highest goal above the floor [m]. noise: the predictive noise is drawn, times this [-]; with 0 every
    particle is followed in its mean. escape: an episode is lost once the robot leaves the box of the recordings by this
    factor [-].
    """

    reward: reward.Config
    command_limit: tuple[float, ...]
    goal_distance: float
    goal_height: tuple[float, float]
    noise: float
    escape: float


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


class Situation(NamedTuple):
    """The robot's state, u_{t-2} and u_{t-1}, the goal; `particle` in [0, 1) says which of the model's is followed."""

    state: Float[Array, " 12"]
    past: Float[Array, "2 6"]
    goal: Float[Array, " 3"]
    particle: Float[Array, ""]


@partial(jax.tree_util.register_dataclass, data_fields=("model", "box"), meta_fields=("config",))
@dataclass(frozen=True)
class LearntSpot:
    """A learnt model of the Spot, its hand to be brought to a goal.

    An episode begins uniformly in the box of the recordings, with a goal uniform about the hand. It follows one
    particle, drawn for the episode: what the model does not know stays the same for as long.
    """

    model: Model
    box: Box
    config: Config

    @property
    def action_size(self) -> int:
        """See `Environment`."""
        return len(SCHEMA.command)

    def reset(self, key: PRNGKeyArray) -> Situation:
        """See `Environment`."""
        key_state, key_past, key_goal, key_particle = jax.random.split(key, 4)
        b, far, (lowest, highest) = self.box, self.config.goal_distance, self.config.goal_height
        state = from_body(jax.random.uniform(key_state, (12,), minval=b.state_low, maxval=b.state_high))
        past = jax.random.uniform(key_past, (HISTORY, 6), minval=b.command_low, maxval=b.command_high)
        about = state[6:9].at[2].set(0.0)
        corners = jnp.array([[-far, -far, lowest], [far, far, highest]])
        goal = about + jax.random.uniform(key_goal, (3,), minval=corners[0], maxval=corners[1])
        return Situation(state, past, goal, jax.random.uniform(key_particle))

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
        lost = ~self._known(following)
        # A state that means nothing is not passed on: not a number times nothing is not nothing.
        kept = jnp.where(lost, state.state, following)
        past = jnp.concatenate([state.past[1:], command[None]])
        return Step(state._replace(state=kept, past=past), gained, lost)

    def _known(self, state: Float[Array, " 12"]) -> Bool[Array, ""]:
        """Whether the state lies in the box, enlarged by `escape`; NaN does not."""
        low, high = self.box.state_low, self.box.state_high
        middle, half = (low + high) / 2, (high - low) / 2
        return jnp.all(jnp.abs(to_body(state) - middle) <= self.config.escape * jnp.maximum(half, 1e-3))


def draw_noise(key: PRNGKeyArray, prediction: Prediction) -> Float[Array, " y"]:
    """The predictive noise: normal, or of Student's t where its degrees of freedom are finite."""
    key_normal, key_t = jax.random.split(key)
    gaussian = jnp.isinf(prediction.dof)
    t = jax.random.t(key_t, jnp.where(gaussian, 1.0, prediction.dof), prediction.scale.shape)
    return prediction.scale * jnp.where(gaussian, jax.random.normal(key_normal, prediction.scale.shape), t)
