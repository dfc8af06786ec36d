"""Functional Stein variational gradient descent [Hoffman et al. 2025, eq. 2]; with a simulator's prior, Sim-FSVGD."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from simgap import networks, priors
from simgap.models import BNN
from simgap.noise import NoiseFamily
from simgap.recordings import Normalisation, normalise
from simgap.types import ConfigError, DivergenceError, Prior, Report


@dataclass(frozen=True)
class Config:
    """Hyperparameters of the inference, in the paper's words [Hoffman et al. 2025, Table 1, General BNN].

    The last four are not the paper's: the share of the N that is kept for validation, how many measurement sets are
    prepared and used in turn, how often the validation NLL is computed [steps], and the steps without a better one
    after which training ends early (never before as many steps without a better one as led to the best).
    """

    particles: int
    batch_size: int
    epochs: int
    max_training_steps: int
    learning_rate: float
    weight_decay: float
    hidden_layer_sizes: tuple[int, ...]
    likelihood_exponent: float
    bandwidth_svgd: float
    validation_share: float
    measurement_sets: int
    evaluate_every: int
    patience: int

    def __post_init__(self) -> None:
        for name in ("particles", "batch_size", "epochs", "max_training_steps", "learning_rate", "bandwidth_svgd",
                     "measurement_sets", "evaluate_every", "patience"):  # fmt: skip
            if getattr(self, name) <= 0:
                raise ConfigError(f"{name} is {getattr(self, name)}; it must be above 0.")
        if not 0 < self.validation_share < 1:
            raise ConfigError(f"validation_share is {self.validation_share}; it must lie between 0 and 1.")

    def training_steps(self, sample_size: int) -> int:
        """100 epochs are 100 N steps, at most `max_training_steps`: the only reading under which the cap binds."""
        return min(self.epochs * sample_size, self.max_training_steps)


Data = tuple[Float[Array, "n x"], Float[Array, "n y"]]


class State(NamedTuple):
    """What training carries: L particles, the noise they share, the optimiser."""

    particles: networks.Particles
    noise: dict[str, Array]
    optimiser: Any


class MeasurementSets(NamedTuple):
    """M measurement sets X, each a batch of b training rows and k points drawn from mu, with the prior at all."""

    batch: Int[Array, "M b"]
    points: Float[Array, "M k x"]
    prior: Prior


def _optimiser(config: Config) -> optax.GradientTransformation:
    # Weights decay towards a simpler function; decaying the noise's parameters would state a belief that nobody has.
    def decays(params: Any) -> Any:
        return jax.tree.map(lambda _: True, params[0]), jax.tree.map(lambda _: False, params[1])

    return optax.adamw(config.learning_rate, weight_decay=config.weight_decay, mask=decays)


def init(key: PRNGKeyArray, inputs: int, outputs: int, config: Config, noise: NoiseFamily) -> State:
    """L particles drawn independently."""
    particles = networks.init(key, config.particles, (inputs, *config.hidden_layer_sizes, outputs))
    noise_params = noise.init(outputs)
    return State(particles, noise_params, _optimiser(config).init((particles, noise_params)))


def measurement_sets(
    key: PRNGKeyArray,
    x_train: Float[Array, "n x"],
    points: Float[Array, "M k x"],
    marginals: priors.Marginals,
    batch_size: int,
) -> MeasurementSets:
    """M measurement sets: the training rows in shuffled batches, epoch after epoch, each with k of the points."""
    count, rows = points.shape[0], min(batch_size, len(x_train))
    batches_per_epoch = len(x_train) // rows
    epochs = -(-count // batches_per_epoch)
    shuffled = jax.vmap(lambda k: jax.random.permutation(k, len(x_train)))(jax.random.split(key, epochs))
    batch = shuffled[:, : batches_per_epoch * rows].reshape(-1, rows)[:count]
    return MeasurementSets(batch, points, priors.prepare(jnp.concatenate([x_train[batch], points], axis=1), marginals))


def svgd_direction(h: Float[Array, "L d"], score: Float[Array, "L d"], bandwidth: float) -> Float[Array, "L d"]:
    """u_l = 1/L sum_i [K_li score_i + grad_{h_i} K_li], K_li = exp(-||h_l - h_i||^2 / (2 b^2)) [eq. 2].

    The direction of ascent: the first term pulls every particle towards the posterior, the second pushes them apart.
    """
    squared = jnp.sum((h[:, None] - h[None]) ** 2, axis=-1)
    K = jnp.exp(-squared / (2 * bandwidth**2))
    repulsion = (h * K.sum(1, keepdims=True) - K @ h) / bandwidth**2
    return (K @ score + repulsion) / h.shape[0]


def step(
    state: State,
    batch: tuple[Float[Array, "b x"], Float[Array, "b y"]],
    points: Float[Array, "k x"],
    prior: Prior,
    n_train: int,
    config: Config,
    noise: NoiseFamily,
) -> tuple[State, dict[str, Array]]:
    """One update theta_l <- theta_l + gamma J_l u_l of all particles, through Adam [eq. 2].

    The measurement set X is the batch together with the points; its posterior score is the prior's score on all of X
    plus, on the batch, the likelihood's, scaled to the n training rows.
    """
    x_batch, y_batch = batch
    L, b = config.particles, x_batch.shape[0]
    weight = n_train**config.likelihood_exponent / b
    h, pull_back = jax.vjp(lambda p: networks.apply(p, jnp.concatenate([x_batch, points])), state.particles)

    def log_likelihood(h_batch: Float[Array, "L b y"], noise_params: dict[str, Array]) -> Float[Array, ""]:
        return noise.log_density(noise_params, y_batch - h_batch).sum()

    likelihood, (likelihood_score, noise_score) = jax.value_and_grad(log_likelihood, argnums=(0, 1))(
        h[:, :b], state.noise
    )
    posterior_score = priors.score(prior, h).at[:, :b].add(weight * likelihood_score)

    u = svgd_direction(h.reshape(L, -1), posterior_score.reshape(L, -1), config.bandwidth_svgd).reshape(h.shape)
    (gradient,) = pull_back(-u)
    noise_gradient = jax.tree.map(lambda g: -weight * g / L, noise_score)

    params = (state.particles, state.noise)
    updates, optimiser = _optimiser(config).update((gradient, noise_gradient), state.optimiser, params)
    particles, noise_params = cast(Any, optax.apply_updates(params, updates))
    return State(particles, noise_params, optimiser), {"train_nll": -likelihood / (L * b)}


@partial(jax.jit, static_argnames=("steps", "config", "noise"))
def _run(
    state: State,
    key: PRNGKeyArray,
    data: tuple[Float[Array, "n x"], Float[Array, "n y"]],
    sets: MeasurementSets,
    steps: int,
    config: Config,
    noise: NoiseFamily,
) -> tuple[State, dict[str, Array]]:
    """`steps` updates, each on a measurement set drawn at random from those prepared; metrics are their means."""
    x, y = data

    def body(state: State, j: Int[Array, ""]) -> tuple[State, dict[str, Array]]:
        batch, points, prior = jax.tree.map(lambda a: a[j], sets)
        return step(state, (x[batch], y[batch]), points, prior, len(x), config, noise)

    state, info = jax.lax.scan(body, state, jax.random.randint(key, (steps,), 0, len(sets.batch)))
    return state, jax.tree.map(jnp.mean, info)


@partial(jax.jit, static_argnames="noise")
def mixture_nll(
    particles: networks.Particles,
    noise_params: dict[str, Array],
    x: Float[Array, "n x"],
    y: Float[Array, "n y"],
    noise: NoiseFamily,
) -> Float[Array, ""]:
    """Mean over rows of -ln 1/L sum_l prod_i p(y_i | h_l(x)_i), in normalised units."""
    log_density = noise.log_density(noise_params, y - networks.apply(particles, x)).sum(-1)
    return -jnp.mean(logsumexp(log_density, axis=0)) + jnp.log(log_density.shape[0])


def train(
    key: PRNGKeyArray,
    data: tuple[Data, Data],
    stats: Normalisation,
    points: Float[Array, "M k x"],
    marginals: priors.Marginals,
    config: Config,
    noise: NoiseFamily,
    report: Report,
) -> BNN:
    """The particles with the best validation NLL met in training.

    `data` are training and validation rows (x, y), and `points` M sets of k samples of mu, all in original units and
    normalised here by `stats`; `marginals` is the prior on normalised inputs and outputs. Training ends after
    `config.training_steps` of all rows given, or early (see `Config.patience`). `report` gets train_nll and
    validation_nll, in original units.

    Raises DivergenceError when an NLL leaves the finite numbers.
    """
    (x_train, y_train), (x_validation, y_validation) = (normalise(stats, x, y) for x, y in data)
    offset = float(jnp.log(stats.y_std).sum())
    key_init, key_sets, key_run = jax.random.split(key, 3)
    normalised_points = (points - stats.x_mean) / stats.x_std
    sets = measurement_sets(key_sets, x_train, normalised_points, marginals, config.batch_size)
    state = init(key_init, x_train.shape[1], y_train.shape[1], config, noise)

    best, best_nll, best_step = state, float("inf"), 0
    last = config.training_steps(len(x_train) + len(x_validation))
    for done in range(config.evaluate_every, last + config.evaluate_every, config.evaluate_every):
        state, info = _run(
            state, jax.random.fold_in(key_run, done), (x_train, y_train), sets, config.evaluate_every, config, noise
        )
        nll = float(mixture_nll(state.particles, state.noise, x_validation, y_validation, noise)) + offset
        train_nll = float(info["train_nll"]) + offset
        report(done, {"train_nll": train_nll, "validation_nll": nll})
        if not (jnp.isfinite(nll) and jnp.isfinite(train_nll)):
            raise DivergenceError(
                f"training diverged within the steps up to {done}: train NLL {train_nll}, validation NLL {nll}. "
                "Lower learning_rate, or look for outliers in the recordings."
            )
        if nll < best_nll:
            best, best_nll, best_step = state, nll, done
        if done - best_step >= max(config.patience, best_step):
            break
    return BNN(best.particles, noise.scale(best.noise), noise.dof(best.noise), stats)
