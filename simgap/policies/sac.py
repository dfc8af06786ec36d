"""Soft actor-critic: one gradient update of policy, twin critics and temperature [Haarnoja et al. 2018].

A batch of 64 and layers of 64 leave a processor little to do per operation, so operations are few: all weights lie in
one vector, which one Adam step moves; the first layers of both critics are one matrix; one gradient serves all losses,
each blind to the weights that are not its own; random numbers come from outside, many updates' at once. All losses are
taken at the weights before the update.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from simgap import draws
from simgap.policies.actor import Layers, perceptron
from simgap.policies.replay import Experience
from simgap.types import ConfigError

_MIN_STD = 1e-3
_BETA1, _BETA2, _EPSILON = 0.9, 0.999, 1e-8  # Adam's


@dataclass(frozen=True)
class Config:
    """SAC's numbers [Hoffman et al. 2025, Table 1]; its weight decays are 0, its action repeat and reward scaling 1.

    `learning_rate_alpha`, `_policy`, `_q`: of the temperature, the policy and the critics. `max_gradient_norm`: of the
    policy's and of the critics' gradient, each. `target_entropy` per entry of an action [nat].
    """

    learning_rate_alpha: float
    learning_rate_policy: float
    learning_rate_q: float
    max_gradient_norm: float
    discounting: float
    batch_size: int
    tau: float
    target_entropy: float
    policy_hidden_layers: tuple[int, ...]
    critic_hidden_layers: tuple[int, ...]

    def __post_init__(self) -> None:
        for name in ("learning_rate_alpha", "learning_rate_policy", "learning_rate_q", "max_gradient_norm",
                     "batch_size"):  # fmt: skip
            if getattr(self, name) <= 0:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be above 0.")
        for name in ("discounting", "tau"):
            if not 0 < getattr(self, name) <= 1:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must lie above 0 and be at most 1.")
        for name in ("policy_hidden_layers", "critic_hidden_layers"):
            if not getattr(self, name) or min(getattr(self, name)) < 1:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be a list of at least one width.")


class Networks(NamedTuple):
    """Shapes of the weights, by layer: weight and bias in turn; known when an update is compiled."""

    actor: tuple[tuple[int, ...], ...]
    critics: tuple[tuple[int, ...], ...]

    @property
    def actor_size(self) -> int:
        """Number of the policy's weights."""
        return sum(map(math.prod, self.actor))

    @property
    def action_size(self) -> int:
        """Number of an action's entries."""
        return self.actor[-1][0] // 2


class Learner(NamedTuple):
    """What an update moves.

    weights: the policy's, both critics' and ln(temperature), one after another. target: of the critics, trailing.
    moment, second_moment: Adam's, of the weights.
    """

    weights: Float[Array, " w"]
    target: Float[Array, " c"]
    moment: Float[Array, " w"]
    second_moment: Float[Array, " w"]
    updates: Int[Array, ""]


def networks(observation_size: int, action_size: int, config: Config) -> Networks:
    """The shapes; critics side by side in the first layer, one above the other in the rest."""
    sizes = (observation_size, *config.policy_hidden_layers, 2 * action_size)
    actor = [shape for i, o in pairwise(sizes) for shape in ((i, o), (o,))]
    first, *rest = config.critic_hidden_layers
    critics: list[tuple[int, ...]] = [(observation_size + action_size, 2 * first), (2 * first,)]
    for i, o in zip((first, *rest), (*rest, 1), strict=True):
        critics += [(2, i, o), (2, 1, o)]
    return Networks(tuple(actor), tuple(critics))


def init(key: PRNGKeyArray, shapes: Networks) -> Learner:
    """LeCun-normal weights, zero biases, temperature 1."""
    keys = iter(jax.random.split(key, len(shapes.actor) + len(shapes.critics)))
    parts = []
    for network in shapes:
        for weight, bias in zip(network[::2], network[1::2], strict=True):
            parts += [draws.normal(next(keys), weight) / math.sqrt(weight[-2]), jnp.zeros(bias)]
    weights = jnp.concatenate([part.reshape(-1) for part in parts] + [jnp.zeros(1)])
    zeros = jnp.zeros_like(weights)
    return Learner(weights, weights[shapes.actor_size : -1], zeros, zeros, jnp.zeros((), jnp.int32))


def actor_layers(weights: Float[Array, " w"], shapes: Networks) -> Layers:
    """The policy's layers."""
    return _layers(_unpacked(weights, shapes.actor))


def explore(layers: Layers, observation: Float[Array, "... o"], key: PRNGKeyArray) -> Float[Array, "... a"]:
    """An action drawn from the policy."""
    location, std = _distribution(layers, observation)
    return jnp.tanh(location + std * draws.normal(key, std.shape))


def exploit(layers: Layers, observation: Float[Array, "... o"]) -> Float[Array, "... a"]:
    """The policy's mode."""
    return jnp.tanh(_distribution(layers, observation)[0])


def update(
    learner: Learner, batch: Experience, normal: Float[Array, "2 b a"], shapes: Networks, config: Config
) -> Learner:
    """One Adam step on all losses, then theta' <- theta' + tau (theta - theta').

    normal: standard normal numbers, for the actions that the policy takes in `following` and in `observation`.
    """
    a = shapes.actor_size
    target = _unpacked(learner.target, shapes.critics)
    gradient = jax.grad(_loss)(_parts(learner.weights, shapes), target, batch, normal, shapes, config)
    policy, critics = (_clipped(_packed(g), config.max_gradient_norm) for g in (gradient.actor, gradient.critics))
    gradient = jnp.concatenate([policy, critics, gradient.log_alpha[None]])

    updates = learner.updates + 1
    moment = _BETA1 * learner.moment + (1 - _BETA1) * gradient
    second_moment = _BETA2 * learner.second_moment + (1 - _BETA2) * gradient**2
    rates = jnp.concatenate([
        jnp.full(a, config.learning_rate_policy),
        jnp.full(len(critics), config.learning_rate_q),
        jnp.array([config.learning_rate_alpha]),
    ])  # fmt: skip
    # moment / (1 - beta_1^t) / (sqrt(second_moment / (1 - beta_2^t)) + epsilon), with one division an entry.
    unbiased = jnp.sqrt(1 - _BETA2**updates)
    step = unbiased / (1 - _BETA1**updates) * rates
    weights = learner.weights - step * moment / (jnp.sqrt(second_moment) + unbiased * _EPSILON)
    target = learner.target + config.tau * (weights[a:-1] - learner.target)
    return Learner(weights, target, moment, second_moment, updates)


class _Parts(NamedTuple):
    """The weights as what they are: a gradient for each of them costs less than one for the vector they lie in."""

    actor: list[Array]
    critics: list[Array]
    log_alpha: Float[Array, ""]


def _parts(weights: Float[Array, " w"], shapes: Networks) -> _Parts:
    a = shapes.actor_size
    return _Parts(_unpacked(weights[:a], shapes.actor), _unpacked(weights[a:-1], shapes.critics), weights[-1])


def _loss(
    weights: _Parts,
    target: list[Array],
    batch: Experience,
    normal: Float[Array, "2 b a"],
    shapes: Networks,
    config: Config,
) -> Float[Array, ""]:
    """The sum of the three losses [Haarnoja et al. 2018, eqs. 5, 7 and 18]."""
    actor, critics = _layers(weights.actor), weights.critics
    alpha = jnp.exp(weights.log_alpha)
    fixed_alpha = stop_gradient(alpha)

    action, log_density = _draw(stop_gradient(actor), batch.following, normal[0])
    value = _q(target, batch.following, action).min(0) - fixed_alpha * log_density
    bellman = batch.reward + config.discounting * batch.discount * value
    error = _q(critics, batch.observation, batch.action) - stop_gradient(bellman)
    critic_loss = 0.5 * jnp.mean(error**2, axis=1).sum()

    action, log_density = _draw(actor, batch.observation, normal[1])
    q = _q(stop_gradient(critics), batch.observation, action).min(0)
    policy_loss = jnp.mean(fixed_alpha * log_density - q)

    target_entropy = config.target_entropy * shapes.action_size
    alpha_loss = alpha * jnp.mean(stop_gradient(-log_density - target_entropy))
    return critic_loss + policy_loss + alpha_loss


def _distribution(
    layers: Layers, observation: Float[Array, "... o"]
) -> tuple[Float[Array, "... a"], Float[Array, "... a"]]:
    """Location and standard deviation before the tanh."""
    location, raw = jnp.split(perceptron(layers, observation), 2, axis=-1)
    return location, jax.nn.softplus(raw) + _MIN_STD


def _draw(
    layers: Layers, observation: Float[Array, "b o"], normal: Float[Array, "b a"]
) -> tuple[Float[Array, "b a"], Float[Array, " b"]]:
    """Actions tanh(location + std normal), and their log density [Haarnoja et al. 2018, eq. 21]."""
    location, std = _distribution(layers, observation)
    raw = location + std * normal
    # ln(1 - tanh(z)^2) = 2 (ln 2 - z - softplus(-2 z)), which does not lose the digits near 1.
    squash = 2 * (math.log(2) - raw - jax.nn.softplus(-2 * raw))
    density = -0.5 * normal**2 - jnp.log(std) - 0.5 * math.log(2 * math.pi) - squash
    return jnp.tanh(raw), density.sum(-1)


def _q(parts: list[Array], observation: Float[Array, "b o"], action: Float[Array, "b a"]) -> Float[Array, "2 b"]:
    """Both critics' values."""
    h = jnp.concatenate([observation, action], axis=1) @ parts[0] + parts[1]
    h = h.reshape(len(h), 2, -1).swapaxes(0, 1)
    for weight, bias in zip(parts[2:-2:2], parts[3:-2:2], strict=True):
        h = jax.nn.swish(h) @ weight + bias
    return (jax.nn.swish(h) @ parts[-2] + parts[-1])[:, :, 0]


def _clipped(gradient: Float[Array, " n"], most: float) -> Float[Array, " n"]:
    """The gradient, shortened to a norm of `most`."""
    return gradient * jnp.minimum(1.0, most / jnp.sqrt(jnp.vdot(gradient, gradient) + 1e-12))


def _layers(parts: list[Array]) -> Layers:
    return list(zip(parts[::2], parts[1::2], strict=True))


def _packed(parts: list[Array]) -> Float[Array, " n"]:
    return jnp.concatenate([part.reshape(-1) for part in parts])


def _unpacked(flat: Float[Array, " n"], shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """The arrays of these shapes that lie one after another at the beginning of a vector."""
    arrays, start = [], 0
    for shape in shapes:
        size = math.prod(shape)
        arrays.append(flat[start : start + size].reshape(shape))
        start += size
    return arrays
