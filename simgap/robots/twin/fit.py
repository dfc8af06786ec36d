"""A twin from sessions: parameters, ages of the sensors and a residual, fitted to windows of many rows."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from simgap import networks
from simgap.noise import FAMILIES
from simgap.recordings import HISTORY, to_transitions
from simgap.residual import body
from simgap.residual import config as residual
from simgap.residual.fit import fit as fit_rows
from simgap.residual.model import ResidualModel
from simgap.robots.twin import rows
from simgap.robots.twin.config import Config
from simgap.robots.twin.model import Twin
from simgap.robots.twin.rows import Rows
from simgap.robots.twin.windows import Windows, cut, errors, padded, predict
from simgap.simulators import parameter_ranges
from simgap.simulators.spot import SCHEMA, to_body
from simgap.types import DivergenceError, Recording, RecordingError, Report, Simulator

NOISE = FAMILIES["student_t"]
"""Of single rows: the stalls make any other law follow a few of them."""
SMALL = 0.1
"""What the residual adds where the network gives 1, in standard deviations of a row's change."""


class Problem(NamedTuple):
    """What the fit to windows holds fixed: the model as fitted to single rows, the arm's reach [m], half the plausible
    ranges of the parameters, and each state's mean change over a window, in which errors are counted."""

    model: ResidualModel
    reach: Float[Array, ""]
    half: Float[Array, " p"]
    scale: Float[Array, " 12"]


class Pool(NamedTuple):
    """Windows, and how many of them, from the first on, batches are drawn from.

    So a fit to some of the sessions and one to all of them run the same program.
    """

    windows: Windows
    size: int


def fit(
    key: PRNGKeyArray,
    sessions: Sequence[Recording],
    replayed: Sequence[Recording],
    simulator: Simulator,
    configs: tuple[Config, residual.Config],
    report: Report,
) -> Twin:
    """The twin of the robot that `sessions` were recorded from; what its rows miss is that of `replayed`.

    First parameters, durations and noise are fitted to single rows, then parameters, ages and residual to windows in
    which every row has its likeliest duration, for the number of steps that is best on sessions held out of a first
    such fit. `report` gets train_nll of single rows and heldout_error, a share of the motion.

    Raises DivergenceError where no fit is finite, RecordingError where sessions are too short.
    """
    config, of_rows = configs
    key_rows, key_model, key_held, key_fit = jax.random.split(key, 4)
    model = _single_rows(key_rows, key_model, sessions, simulator, (config, of_rows), report)
    first, heldout = _divided(key_held, [rows.timed(model, r) for r in sessions], config)
    windows = jax.tree.map(lambda *parts: jnp.concatenate(parts), first, heldout)
    problem = _problem(model, jnp.asarray(rows.reach(sessions), jnp.float32), windows)
    later: Report = lambda done, metrics: report(of_rows.simulator_steps + done, metrics)  # noqa: E731
    everything = padded(windows)
    steps = _choose(key_fit, problem, (Pool(everything, len(first.duration)), heldout), config, later)
    return _twin(problem, _train(key_fit, problem, Pool(everything, len(windows.duration)), config, steps), replayed)


def _single_rows(
    key: PRNGKeyArray,
    key_model: PRNGKeyArray,
    sessions: Sequence[Recording],
    simulator: Simulator,
    configs: tuple[Config, residual.Config],
    report: Report,
) -> ResidualModel:
    """The simulator with the parameters, durations and noise of single rows, and a residual that is zero so far."""
    config, of_rows = configs
    data = to_transitions(SCHEMA, sessions)
    x, y = jnp.asarray(data.x), jnp.asarray(data.y)
    fitted = fit_rows(key, (x, y), simulator, of_rows, NOISE, report)
    features = jax.vmap(lambda x: body.features(simulator, x))(x)
    unit = jax.vmap(lambda x, y: body.lift(simulator.schema, x).T @ y)(x, y).std(0)
    std = features.std(0)
    sizes = (features.shape[1], *config.hidden_layer_sizes, unit.shape[0])
    *inner, (weight, bias) = networks.init(key_model, 1, sizes)
    one = jnp.ones(())
    return ResidualModel(
        simulator, fitted.params, fitted.durations, one, one, [*inner, (jnp.zeros_like(weight), bias)],
        features.mean(0), jnp.where(std > 1e-6, std, 1.0), SMALL * unit,
        fitted.y_std * NOISE.scale(fitted.noise), NOISE.dof(fitted.noise),
    )  # fmt: skip


def _divided(key: PRNGKeyArray, sessions: Sequence[Rows], config: Config) -> tuple[Windows, Windows]:
    """Windows to fit to, and those of whole sessions that choose the number of steps."""
    long = [s for s in sessions if len(s.state) > config.horizon + HISTORY]
    if len(long) < 2:
        raise RecordingError(
            f"{len(long)} of {len(sessions)} sessions have more than {config.horizon + HISTORY} rows; a twin needs two "
            "such sessions. Give longer sessions, or lower twin.fit.horizon."
        )
    order = np.asarray(jax.random.permutation(key, len(long)))
    count = min(len(long) - 1, max(1, round(config.heldout_share * len(long))))
    held, kept = ([long[i] for i in some] for some in (order[:count], order[count:]))
    return cut(kept, config.horizon, config.stride), cut(held, config.horizon, config.stride)


def _problem(model: ResidualModel, reach: Float[Array, ""], windows: Windows) -> Problem:
    low, high = parameter_ranges(model.simulator)
    still = jnp.broadcast_to(windows.state[:, :1], windows.state[:, 1:].shape)
    return Problem(model, reach, jnp.asarray(high - low) / 2, jnp.abs(errors(still, windows)).mean((0, 1)))


def _variables(problem: Problem) -> dict[str, Any]:
    return {"z": jnp.zeros(len(problem.half)), "ages": jnp.zeros(2), "particles": problem.model.particles}


def _model(problem: Problem, variables: dict[str, Any]) -> ResidualModel:
    params = problem.model.params + problem.half * variables["z"]
    return replace(problem.model, params=params, particles=variables["particles"])


@jax.jit
def _error(variables: dict[str, Any], problem: Problem, windows: Windows) -> Float[Array, ""]:
    """Mean absolute error as a share of the motion, over states, rows and windows."""
    predicted = predict(_model(problem, variables), variables["ages"], problem.reach, windows)
    return (jnp.abs(errors(predicted, windows)) / problem.scale).mean()


def _choose(key: PRNGKeyArray, problem: Problem, parts: tuple[Pool, Windows], config: Config, report: Report) -> int:
    """The number of steps of the least error on the second part, fitted to the first; 0 is one of them."""
    training, heldout = parts
    curve = {0: float(_error(_variables(problem), problem, heldout))}

    def watch(done: int, variables: dict[str, Any]) -> None:
        curve[done] = float(_error(variables, problem, heldout))
        report(done, {"heldout_error": curve[done]})

    _train(key, problem, training, config, config.training_steps, watch)
    finite = {steps: error for steps, error in curve.items() if np.isfinite(error)}
    if not finite:
        raise DivergenceError("no prediction of the twin is finite on the sessions held out. Lower twin.learning_rate.")
    return min(finite, key=finite.__getitem__)


def _train(
    key: PRNGKeyArray,
    problem: Problem,
    training: Pool,
    config: Config,
    steps: int,
    watch: Callable[[int, dict[str, Any]], None] = lambda *_: None,
) -> dict[str, Any]:
    """Train for `steps` of the `config.training_steps` steps; calls `watch(step, variables)` every `evaluate_every`."""
    variables = _variables(problem)
    state = _optimiser(config).init(variables)
    for done in range(config.evaluate_every, steps + 1, config.evaluate_every):
        variables, state = _run((variables, state), jax.random.fold_in(key, done), problem, training, config)
        watch(done, variables)
    return variables


def _optimiser(config: Config) -> optax.GradientTransformation:
    physics, network = (
        optax.cosine_decay_schedule(rate, config.training_steps)
        for rate in (config.simulator_learning_rate, config.learning_rate)
    )
    decayed = optax.adamw(network, weight_decay=config.weight_decay)
    labels = {"z": "physics", "ages": "physics", "particles": "network"}
    return optax.chain(
        optax.clip(1.0), optax.multi_transform({"physics": optax.adam(physics), "network": decayed}, labels)
    )


@partial(jax.jit, static_argnames="config")
def _run(
    carry: tuple[dict[str, Any], Any], key: PRNGKeyArray, problem: Problem, training: Pool, config: Config
) -> tuple[dict[str, Any], Any]:
    optimiser, (windows, count) = _optimiser(config), training
    size = min(config.batch_size, len(windows.duration))

    def step(carry: tuple[dict[str, Any], Any], key: Array) -> tuple[tuple[dict[str, Any], Any], None]:
        variables, state = carry
        some = jax.random.randint(key, (size,), 0, count)
        gradient = jax.grad(_error)(variables, problem, jax.tree.map(lambda a: a[some], windows))
        updates, state = optimiser.update(gradient, state, variables)
        return (cast(Any, optax.apply_updates(variables, updates)), state), None

    return jax.lax.scan(step, carry, jax.random.split(key, config.evaluate_every))[0]


def _twin(problem: Problem, variables: dict[str, Any], replayed: Sequence[Recording]) -> Twin:
    """With the durations that are likeliest now."""
    model, ages = _model(problem, variables), variables["ages"]
    own = [rows.timed(model, r) for r in replayed]
    missed = np.concatenate([rows.missed(model, ages, problem.reach, s) for s in own])
    durations = np.concatenate([s.duration[HISTORY:] for s in own])
    starts = np.stack([np.asarray(to_body(jnp.asarray(r.state[0], jnp.float32)))[6:9] for r in replayed])
    home, row_s = np.median(starts, axis=0), rows.seconds(replayed)
    return Twin(model, ages, problem.reach, *(jnp.asarray(a, jnp.float32) for a in (durations, missed, home, row_s)))
