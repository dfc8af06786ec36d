"""A policy learnt in an environment: act, remember, update, evaluate; interrupted, it goes on to the same result."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from simgap import draws
from simgap.policies import replay, sac
from simgap.policies.actor import Layers
from simgap.policies.environment import Environment
from simgap.policies.replay import Experience, Replay
from simgap.types import ConfigError, DivergenceError, Report


@dataclass(frozen=True)
class Config:
    """How much is done of what [Hoffman et al. 2025, Table 1].

    A cycle is `steps_between_updates` steps of `environments` environments and then `updates` gradient updates;
    `environment_steps` is the sum over environments. `min_replay` steps are taken at random before the first update.
    The policy is evaluated `evaluations` times, evenly spaced, for an episode in each of `evaluation_environments`.
    Learning ends early when the best of the last `plateau` returns exceeds the best before them by no more than
    `plateau_gain` of what had been gained since the first evaluation; with `plateau` 0 it never does.
    """

    environment_steps: int
    episode_length: int
    steps_between_updates: int
    environments: int
    updates: int
    min_replay: int
    max_replay: int
    evaluations: int
    evaluation_environments: int
    plateau: int
    plateau_gain: float

    def __post_init__(self) -> None:
        for field in fields(self):
            least = 0 if field.name in ("plateau", "plateau_gain") else 1
            if getattr(self, field.name) < least:
                raise ConfigError(f"{field.name} is {getattr(self, field.name)}; it must be at least {least}.")
        if self.max_replay < max(self.prefill_steps * self.environments, self.cycle_steps):
            raise ConfigError(f"max_replay is {self.max_replay}; it must hold min_replay steps, and those of a cycle.")
        if self.environment_steps < self.prefill_steps * self.environments + self.evaluations * self.cycle_steps:
            raise ConfigError(
                f"environment_steps is {self.environment_steps}; it must be enough for min_replay steps and, before "
                f"each of the {self.evaluations} evaluations, a cycle of {self.cycle_steps}."
            )

    @property
    def cycle_steps(self) -> int:
        """Environment steps of a cycle."""
        return self.steps_between_updates * self.environments

    @property
    def prefill_steps(self) -> int:
        """Random steps of each environment."""
        return -(-self.min_replay // self.environments)

    @property
    def cycles_per_evaluation(self) -> int:
        """Cycles between evaluations."""
        cycles = (self.environment_steps - self.prefill_steps * self.environments) // self.cycle_steps
        return max(1, round(cycles / self.evaluations))


class Places(NamedTuple):
    """Where a batch of environments is, and how many steps of its episode each has taken."""

    state: Any
    clock: Int[Array, " E"]


class Training(NamedTuple):
    """All that learning remembers between evaluations; `returns` holds those evaluated, NaN where none is yet.

    `best` is the policy, with the best return so far, that the result is made of. Every evaluation draws the same
    starts and noise, from `key_evaluation`.
    """

    key: PRNGKeyArray
    key_evaluation: PRNGKeyArray
    learner: sac.Learner
    memory: Replay
    places: Places
    mean: Float[Array, " o"]
    std: Float[Array, " o"]
    returns: Float[Array, " evaluations"]
    best: Layers


class Learnt(NamedTuple):
    """A policy's network, and the statistics of the observations that it takes normalised."""

    layers: Layers
    mean: Float[Array, " o"]
    std: Float[Array, " o"]


def learn(
    key: PRNGKeyArray,
    environment: Environment,
    config: Config,
    sac_config: sac.Config,
    report: Report,
    resumed: Training | None = None,
    keep: Callable[[Training], None] = lambda _: None,
) -> Learnt:
    """The policy with the best evaluated return.

    `report(step, metrics)` tells environment steps, return and share of episodes lost after every evaluation;
    `keep(training)` is given all that is needed to go on from there, as `resumed`, to the same result. Raises
    DivergenceError when weights or returns are not finite, or when every episode of two evaluations in a row is lost:
    one alone may be of a policy that has learnt little.
    """
    training = init(key, environment, config, sac_config) if resumed is None else resumed
    all_lost = False
    for k in range(evaluated(training), config.evaluations):
        if at_plateau([float(r) for r in training.returns[:k]], config):
            break
        training, metrics = advance(training, jnp.int32(k), environment, config, sac_config)
        steps = config.prefill_steps * config.environments + (k + 1) * config.cycles_per_evaluation * config.cycle_steps
        told = {name: float(value) for name, value in metrics.items()}
        report(steps, told)
        _check(steps, told, all_lost)
        all_lost = told["lost"] == 1.0
        keep(training)
    return Learnt(training.best, training.mean, training.std)


def to_arrays(training: Training) -> dict[str, np.ndarray]:
    """All of it as named arrays, to be written to a file."""
    leaves = jax.tree.leaves(_plain(training))
    return {f"leaf_{i:02}": np.asarray(leaf) for i, leaf in enumerate(leaves)}


def from_arrays(
    arrays: Mapping[str, np.ndarray], environment: Environment, config: Config, sac_config: sac.Config
) -> Training:
    """What `to_arrays` made; ValueError where it was made with other sizes."""
    shape = jax.eval_shape(lambda key: init(key, environment, config, sac_config), jax.random.key(0))
    expected, structure = jax.tree.flatten(jax.eval_shape(_plain, shape))
    leaves = [jnp.asarray(arrays[name]) for name in sorted(arrays)]
    if [leaf.shape for leaf in leaves] != [leaf.shape for leaf in expected]:
        raise ValueError("its arrays have other shapes than these parameters ask for")
    training = jax.tree.unflatten(structure, leaves)
    wrap = jax.random.wrap_key_data
    return training._replace(key=wrap(training.key), key_evaluation=wrap(training.key_evaluation))


def _plain(training: Training) -> Training:
    """Its keys as the numbers they are."""
    plain = jax.random.key_data
    return training._replace(key=plain(training.key), key_evaluation=plain(training.key_evaluation))


def evaluated(training: Training) -> int:
    """How many evaluations lie behind."""
    return int(jnp.sum(jnp.isfinite(training.returns)))


def at_plateau(returns: list[float], config: Config) -> bool:
    """Whether the returns have stopped rising, as `Config` says."""
    if not config.plateau or len(returns) <= config.plateau + 1:
        return False
    before, last = max(returns[: -config.plateau]), max(returns[-config.plateau :])
    return last - before <= config.plateau_gain * (before - returns[0])


def _check(steps: int, metrics: dict[str, float], all_lost: bool) -> None:
    """`all_lost`: whether every episode of the evaluation before was lost."""
    if not all(map(jnp.isfinite, metrics.values())):
        raise DivergenceError(
            f"the policy left the finite numbers before environment step {steps:,} ({metrics}). "
            "Lower policy.sac's learning rates or max_gradient_norm."
        )
    if all_lost and metrics["lost"] == 1.0:
        raise DivergenceError(
            f"every episode of the last two evaluations was lost at environment step {steps:,}: the model's rollouts "
            "explode, or nothing keeps the hand within track.bounds. Train the model on more transitions, raise "
            "policy.environment.escape, or set policy.environment.stopped to false."
        )


@partial(jax.jit, static_argnames=("config", "sac_config"))
def init(key: PRNGKeyArray, environment: Environment, config: Config, sac_config: sac.Config) -> Training:
    """Untrained networks, and a memory of random actions, whose observations give the normalisation."""
    key, key_evaluation, key_reset, key_clock, key_steps, key_learner = jax.random.split(key, 6)
    state = jax.vmap(environment.reset)(jax.random.split(key_reset, config.environments))
    # Begun at different times, episodes do not all end at once.
    clock = jnp.int32(jax.random.uniform(key_clock, (config.environments,)) * config.episode_length)
    places = Places(state, clock)

    def anyhow(observation: Float[Array, "E o"], key: PRNGKeyArray) -> Float[Array, "E a"]:
        return jax.random.uniform(key, (len(observation), environment.action_size), minval=-1.0)

    places, seen = _interact(environment, places, anyhow, key_steps, config.prefill_steps, config.episode_length)
    mean, std = seen.observation.mean(0), seen.observation.std(0)
    std = jnp.where(std > 1e-6, std, 1.0)
    shapes = sac.networks(len(mean), environment.action_size, sac_config)
    learner = sac.init(key_learner, shapes)
    memory = replay.init(config.max_replay, len(mean), environment.action_size)
    memory = replay.add(memory, _normalised(seen, mean, std))
    best, returns = sac.actor_layers(learner.weights, shapes), jnp.full(config.evaluations, jnp.nan, jnp.float32)
    return Training(key, key_evaluation, learner, memory, places, mean, std, returns, best)


@partial(jax.jit, static_argnames=("config", "sac_config"), donate_argnums=0)
def advance(
    training: Training, evaluation: Int[Array, ""], environment: Environment, config: Config, sac_config: sac.Config
) -> tuple[Training, dict[str, Float[Array, ""]]]:
    """The cycles up to the next evaluation, and that evaluation."""
    mean, std = training.mean, training.std
    shapes = sac.networks(len(mean), environment.action_size, sac_config)
    key, key_cycles = jax.random.split(training.key)

    def cycle(
        carry: tuple[sac.Learner, Replay, Places], key: PRNGKeyArray
    ) -> tuple[tuple[sac.Learner, Replay, Places], None]:
        learner, memory, places = carry
        key_steps, key_updates = jax.random.split(key)
        layers = sac.actor_layers(learner.weights, shapes)

        def act(observation: Float[Array, "E o"], key: PRNGKeyArray) -> Float[Array, "E a"]:
            return sac.explore(layers, (observation - mean) / std, key)

        places, seen = _interact(
            environment, places, act, key_steps, config.steps_between_updates, config.episode_length
        )
        memory = replay.add(memory, _normalised(seen, mean, std))

        def update(learner: sac.Learner, drawn: tuple[Array, Array]) -> tuple[sac.Learner, None]:
            batch = replay.sample(memory, drawn[0], shapes.action_size)
            return sac.update(learner, batch, drawn[1], shapes, sac_config), None

        # Drawn at once: every call of the generator costs as much as some of an update's matrix products.
        key_rows, key_actions = jax.random.split(key_updates)
        each = (config.updates, sac_config.batch_size)
        actions = (config.updates, 2, sac_config.batch_size, shapes.action_size)
        drawn = jax.random.uniform(key_rows, each), draws.normal(key_actions, actions)
        learner, _ = jax.lax.scan(update, learner, drawn)
        return (learner, memory, places), None

    keys = jax.random.split(key_cycles, config.cycles_per_evaluation)
    (learner, memory, places), _ = jax.lax.scan(cycle, (training.learner, training.memory, training.places), keys)
    layers = sac.actor_layers(learner.weights, shapes)
    gained, lost = evaluate(Learnt(layers, mean, std), environment, training.key_evaluation, config)
    better = ~(jnp.nanmax(training.returns) >= gained)
    best = jax.tree.map(lambda new, old: jnp.where(better, new, old), layers, training.best)
    returns = training.returns.at[evaluation].set(gained)
    metrics = {"return": gained, "lost": lost, "temperature": jnp.exp(learner.weights[-1])}
    after = Training(key, training.key_evaluation, learner, memory, places, mean, std, returns, best)
    return after, metrics


def evaluate(
    learnt: Learnt, environment: Environment, key: PRNGKeyArray, config: Config
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Mean undiscounted return of the policy's mode over an episode, and the share of episodes lost on the way."""
    key_reset, key_steps = jax.random.split(key)
    state = jax.vmap(environment.reset)(jax.random.split(key_reset, config.evaluation_environments))

    def step(
        carry: tuple[Any, Bool[Array, " E"]], key: PRNGKeyArray
    ) -> tuple[tuple[Any, Bool[Array, " E"]], Float[Array, " E"]]:
        state, over = carry
        observation = (jax.vmap(environment.observe)(state) - learnt.mean) / learnt.std
        action = sac.exploit(learnt.layers, observation)
        following, reward, lost = jax.vmap(environment.step)(state, action, jax.random.split(key, len(action)))
        return (following, over | lost), jnp.where(over, 0.0, reward)

    over = jnp.zeros(config.evaluation_environments, bool)
    (_, over), rewards = jax.lax.scan(step, (state, over), jax.random.split(key_steps, config.episode_length))
    return rewards.sum(0).mean(), over.mean()


def _interact(
    environment: Environment,
    places: Places,
    act: Callable[[Float[Array, "E o"], PRNGKeyArray], Float[Array, "E a"]],
    key: PRNGKeyArray,
    steps: int,
    episode_length: int,
) -> tuple[Places, Experience]:
    """So many steps of every environment, and all that was seen.

    An episode that is lost has no future; one whose time is up had one, and its last transition says so.
    """

    def step(places: Places, key: PRNGKeyArray) -> tuple[Places, Experience]:
        key_act, key_step, key_reset = jax.random.split(key, 3)
        observation = jax.vmap(environment.observe)(places.state)
        action = act(observation, key_act)
        following, reward, lost = jax.vmap(environment.step)(
            places.state, action, jax.random.split(key_step, len(action))
        )
        seen = Experience(observation, action, reward, 1.0 - lost, jax.vmap(environment.observe)(following))
        fresh = jax.vmap(environment.reset)(jax.random.split(key_reset, len(action)))
        over = lost | (places.clock + 1 >= episode_length)
        chosen = jax.tree.map(lambda f, n: jnp.where(over.reshape(-1, *[1] * (n.ndim - 1)), f, n), fresh, following)
        return Places(chosen, jnp.where(over, 0, places.clock + 1)), seen

    places, seen = jax.lax.scan(step, places, jax.random.split(key, steps))
    return places, jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), seen)


def _normalised(seen: Experience, mean: Float[Array, " o"], std: Float[Array, " o"]) -> Experience:
    return seen._replace(observation=(seen.observation - mean) / std, following=(seen.following - mean) / std)
