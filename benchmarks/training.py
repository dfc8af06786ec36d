"""Speed of training FSVGD and Sim-FSVGD at the sizes of params.yaml, against a training loop in Python.

    python -m benchmarks.training [--steps N] [--repeats R]

Ours is what `simgap.fsvgd.train` does between two reports: a scan over prepared measurement sets, then the validation
NLL. The baseline is the same model trained in the straightforward way: one compiled update per step, dispatched from
Python, on a minibatch gathered on the host and on fresh measurement points, the prior computed anew in every step.
Networks, SVGD direction, noise and optimiser are the project's own in both; one update of both is compared first.
All cases take turns within every repeat. Prints a table and writes benchmarks/training.json.
"""

import argparse
import dataclasses
import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Float, PRNGKeyArray

from simgap import fsvgd, identify, networks, priors
from simgap.domain import uniform_inputs
from simgap.noise import FAMILIES, NoiseFamily, gaussian
from simgap.recordings import HISTORY, Normalisation, encode_state, normalisation, normalise
from simgap.simulators import normalised_functions, parameter_ranges, sample_parameters, state_difference
from simgap.simulators.spot import Spot
from tasks.params import Params, load_params
from tasks.train import grid, steps_at_most

ROOT = Path(__file__).parents[1]
OUTPUT = ROOT / "benchmarks" / "training.json"
SAMPLE_SIZE = 2000
TRAININGS = {"in full": 200_000, "stopped early": 15_000}
"""Steps of a training, over which the preparation of the prior is spread."""

# Spot in its own frame: base pose [m, m, rad], base velocity [m/s, m/s, rad/s], hand from the base [m], its velocity
# [m/s]; commands [m/s, rad/s].
STATE_LOW = (-2.0, -2.0, -3.0, -1.0, -1.0, -1.0, 0.5, -0.3, 0.2, -0.5, -0.5, -0.5)
STATE_HIGH = (2.0, 2.0, 3.0, 1.0, 1.0, 1.0, 0.9, 0.3, 0.8, 0.5, 0.5, 0.5)
COMMAND_HIGH = 1.0
NOISE_STD = 0.05
"""Standard deviation of the outputs' noise, in units of each output's own."""
TOLERANCE = 1e-4
"""Relative difference allowed between one update of ours and of the baseline; without FSVGD's prior it is 8e-4."""

Job = Callable[[], object]


class Problem(NamedTuple):
    """What one model learns from. Rows are normalised by `stats`; `box` holds two corners, in original units."""

    training: fsvgd.Data
    validation: fsvgd.Data
    box: Float[Array, "2 x"]
    stats: Normalisation
    marginals: priors.Marginals
    points: int
    config: fsvgd.Config
    noise: NoiseFamily


class Cell(NamedTuple):
    """A problem with what one seed draws for it, ready to be trained."""

    problem: Problem
    key: PRNGKeyArray
    state: fsvgd.State
    sets: fsvgd.MeasurementSets


# The problem


def input_box(spot: Spot) -> Float[Array, "2 x"]:
    """Two inputs at opposite corners of the box in which robot and commands may be."""
    encode = jax.vmap(lambda body: encode_state(spot.schema, spot.from_body(body)))
    commands = jnp.full((HISTORY + 1) * len(spot.schema.command), COMMAND_HIGH)
    corners = encode(jnp.array([STATE_LOW, STATE_HIGH]))
    return jnp.concatenate([corners, jnp.stack([-commands, commands])], axis=1)


def synthetic_transitions(key: PRNGKeyArray, count: int, spot: Spot) -> fsvgd.Data:
    """Inputs uniform in the box; outputs from the simulator in the middle of its ranges, with noise."""
    key_x, key_y = jax.random.split(key)
    x = uniform_inputs(key_x, count, input_box(spot), spot)
    low, high = parameter_ranges(spot)
    y = jax.vmap(lambda x: state_difference(spot, jnp.asarray(low + high) / 2, x))(x)
    return x, y + NOISE_STD * y.std(0) * jax.random.normal(key_y, y.shape)


def make_problem(model: str, params: Params) -> Problem:
    """FSVGD or Sim-FSVGD with Gaussian noise, on N = 2000 synthetic transitions."""
    spot, train = Spot(1 / params.transitions.nominal_rate_hz), params.train
    key_data, key_phi = jax.random.split(jax.random.key(0))
    x, y = synthetic_transitions(key_data, SAMPLE_SIZE, spot)
    count = round(train.bnn.validation_share * SAMPLE_SIZE)
    stats = normalisation(x[count:], y[count:])
    if model == "fsvgd":
        prior, marginals = train.fsvgd, priors.gp_marginals(y.shape[1], train.fsvgd)
    else:
        prior, phi = train.sim_fsvgd, sample_parameters(spot, key_phi, train.sim_fsvgd.function_samples)
        marginals = priors.simulator_marginals(normalised_functions(spot, phi, stats), prior)
    training, validation = normalise(stats, x[count:], y[count:]), normalise(stats, x[:count], y[:count])
    return Problem(
        training, validation, input_box(spot), stats, marginals, prior.measurement_points, train.bnn, gaussian
    )


def draw_points(problem: Problem, key: PRNGKeyArray, count: int) -> Float[Array, "count x"]:
    """Samples of mu, normalised."""
    points = uniform_inputs(key, count, problem.box, Spot())
    return (points - problem.stats.x_mean) / problem.stats.x_std


def init(problem: Problem, key: PRNGKeyArray) -> fsvgd.State:
    """The state training starts from."""
    x, y = problem.training
    return fsvgd.init(key, x.shape[1], y.shape[1], problem.config, problem.noise)


# Ours


def prepare_cell(problem: Problem, seed: int) -> Cell:
    """Draw the measurement points and prepare the prior at them, as for every cell of the grid."""
    key, key_points, key_sets, key_init = jax.random.split(jax.random.key(seed), 4)
    sets = problem.config.measurement_sets
    points = draw_points(problem, key_points, sets * problem.points).reshape(sets, problem.points, -1)
    prepared = fsvgd.measurement_sets(
        key_sets, problem.training[0], points, problem.marginals, problem.config.batch_size
    )
    return jax.block_until_ready(Cell(problem, key, init(problem, key_init), prepared))


def with_noise(cell: Cell, noise: NoiseFamily) -> Cell:
    """The cell with another noise; the prior does not depend on it."""
    problem = cell.problem._replace(noise=noise)
    return cell._replace(problem=problem, state=init(problem, cell.key))


def chunk(
    problem: Problem, steps: int, state: fsvgd.State, key: PRNGKeyArray, sets: fsvgd.MeasurementSets
) -> Float[Array, ""]:
    """What `fsvgd.train` does between two reports; gives the validation NLL."""
    state, _ = fsvgd._run(state, key, problem.training, sets, steps, problem.config, problem.noise)
    return fsvgd.mixture_nll(state.particles, state.noise, *problem.validation, problem.noise)


def train_cell(cell: Cell, steps: int) -> float:
    """One chunk of one cell."""
    return finite(chunk(cell.problem, steps, cell.state, cell.key, cell.sets))


def batched(cells: Sequence[Cell], steps: int) -> Job:
    """One chunk of all the cells, their seeds a leading axis of one compiled computation."""
    problem = cells[0].problem
    stacked: Any = jax.tree.map(lambda *a: jnp.stack(a), *[(cell.state, cell.key, cell.sets) for cell in cells])
    run = jax.jit(jax.vmap(lambda state, key, sets: chunk(problem, steps, state, key, sets)))
    return lambda: finite(run(*stacked).max())


def finite(nll: Float[Array, ""]) -> float:
    """The number, when it has been computed; a benchmark of NaNs says nothing."""
    value = float(nll)
    if not np.isfinite(value):
        raise FloatingPointError(f"an NLL is {value}; it must be finite. Lower --steps.")
    return value


# The baseline


def baseline_prior_score(
    marginals: priors.Marginals, x: Float[Array, "k x"], h: Float[Array, "L k y"]
) -> Float[Array, "L k y"]:
    """The prior's score at fresh points: marginals, Cholesky factors and two triangular solves, in the step."""
    mean, covariance = marginals(x)
    o, k = covariance.shape[:2]
    factors = jnp.linalg.cholesky(covariance + priors.JITTER * jnp.eye(k))
    difference = (h - mean).reshape(len(h), k, o, -1).transpose(2, 1, 3, 0)
    solved = jax.vmap(lambda factor, d: cho_solve((factor, True), d))(factors, difference.reshape(o, k, -1))
    return -solved.reshape(difference.shape).transpose(3, 1, 0, 2).reshape(h.shape)


def baseline_step(
    problem: Problem, state: fsvgd.State, batch: fsvgd.Data, points: Float[Array, "k x"]
) -> tuple[fsvgd.State, dict[str, Array]]:
    """`fsvgd.step` with the prior computed in it."""
    (x_batch, y_batch), config, noise = batch, problem.config, problem.noise
    L, b = config.particles, len(x_batch)
    weight = len(problem.training[0]) ** config.likelihood_exponent / b
    x = jnp.concatenate([x_batch, points])
    h, pull_back = jax.vjp(lambda p: networks.apply(p, x), state.particles)
    likelihood, (likelihood_score, noise_score) = jax.value_and_grad(
        lambda h, params: noise.log_density(params, y_batch - h).sum(), argnums=(0, 1)
    )(h[:, :b], state.noise)
    score = baseline_prior_score(problem.marginals, x, h).at[:, :b].add(weight * likelihood_score)
    u = fsvgd.svgd_direction(h.reshape(L, -1), score.reshape(L, -1), config.bandwidth_svgd).reshape(h.shape)
    gradient = (pull_back(-u)[0], jax.tree.map(lambda g: -weight * g / L, noise_score))
    params = (state.particles, state.noise)
    updates, optimiser = fsvgd._optimiser(config).update(gradient, state.optimiser, params)
    particles, noise_params = cast(Any, optax.apply_updates(params, updates))
    return fsvgd.State(particles, noise_params, optimiser), {"train_nll": -likelihood / (L * b)}


def baseline(cell: Cell, steps: int) -> Job:
    """The training loop in Python: gather on the host, dispatch one compiled update; the validation NLL at the end."""
    problem, random = cell.problem, np.random.default_rng(0)
    x, y = map(np.asarray, problem.training)

    @jax.jit
    def update(
        state: fsvgd.State, key: PRNGKeyArray, j: int, batch: fsvgd.Data
    ) -> tuple[fsvgd.State, dict[str, Array]]:
        points = draw_points(problem, jax.random.fold_in(key, j), problem.points)
        return baseline_step(problem, state, batch, points)

    def loop() -> float:
        state = cell.state
        for j in range(steps):
            rows = random.integers(0, len(x), problem.config.batch_size)
            state, _ = update(state, cell.key, j, (x[rows], y[rows]))
        return finite(fsvgd.mixture_nll(state.particles, state.noise, *problem.validation, problem.noise))

    return loop


def differences(cell: Cell) -> dict[str, float]:
    """|ours - baseline| / |ours| on one measurement set: of the prior's score, and of one step's gradient."""
    problem, (x, y) = cell.problem, cell.problem.training
    rows, points, prior = jax.tree.map(lambda a: a[0], cell.sets)
    batch, measured = (x[rows], y[rows]), jnp.concatenate([x[rows], points])
    h = networks.apply(cell.state.particles, measured)
    scores = (priors.score(prior, h), baseline_prior_score(problem.marginals, measured, h))
    ours, _ = fsvgd.step(cell.state, batch, points, prior, len(x), problem.config, problem.noise)
    theirs, _ = jax.jit(lambda state: baseline_step(problem, state, batch, points))(cell.state)
    # Adam's first moment after one step is the gradient, scaled.
    gradients = [optax.tree_utils.tree_get(state.optimiser, "mu") for state in (ours, theirs)]
    return {"prior_score": relative_difference(*scores), "gradient": relative_difference(*gradients)}


def relative_difference(a: Any, b: Any) -> float:
    """|a - b| / |a| over all leaves."""
    a, b = ravel_pytree(a)[0], ravel_pytree(b)[0]
    return float(jnp.linalg.norm(a - b) / jnp.linalg.norm(a))


# Measuring


class Case(NamedTuple):
    """A job that trains so many models for `--steps` steps each."""

    job: Job
    models: int


def side_by_side(jobs: Sequence[Job]) -> None:
    """All jobs at once, a thread each, as the pipeline trains."""
    with ThreadPoolExecutor(len(jobs)) as pool:
        for future in [pool.submit(job) for job in jobs]:
            future.result()


def seconds(job: Job) -> float:
    """Wall-clock time of the job."""
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


def measure(cases: Mapping[str, Case], steps: int, repeats: int) -> dict[str, list[float]]:
    """Milliseconds per model and step. A first call of each compiles; then they take turns, back and forth."""
    for case in cases.values():
        case.job()
    ms: dict[str, list[float]] = {name: [] for name in cases}
    for repeat in range(repeats):
        for name in list(cases)[:: 1 if repeat % 2 == 0 else -1]:
            ms[name].append(1e3 * seconds(cases[name].job) / (cases[name].models * steps))
    return ms


def spread(values: Sequence[float]) -> dict[str, float]:
    """Least, median and greatest."""
    return {"min": min(values), "median": statistics.median(values), "max": max(values)}


def ratio(ms: Mapping[str, Sequence[float]], numerator: str, denominator: str) -> dict[str, float]:
    """The ratio within each repeat."""
    return spread([a / b for a, b in zip(ms[numerator], ms[denominator], strict=True)])


def bnn_cases(cells: Sequence[Cell], params: Params, steps: int) -> dict[str, Case]:
    """Everything measured of one model; ours and the baseline are neighbours in time."""
    workers, seeds = params.train.workers, len(params.train.seeds)
    cases = {
        "ours": Case(partial(train_cell, cells[0], steps), 1),
        "baseline": Case(baseline(cells[0], steps), 1),
        "seeds in turn": Case(lambda: [train_cell(cell, steps) for cell in cells[:seeds]], seeds),
        "seeds batched": Case(batched(cells[:seeds], steps), seeds),
    }
    for noise in params.train.noises:
        jobs = [partial(train_cell, with_noise(cell, FAMILIES[noise]), steps) for cell in cells[:workers]]
        cases[f"threads, {noise}"] = Case(partial(side_by_side, jobs), workers)
    return cases


def benchmark_bnn(model: str, params: Params, steps: int, repeats: int) -> dict[str, Any]:
    """All figures of FSVGD or Sim-FSVGD."""
    problem, cells, preparation = make_problem(model, params), [], []
    for seed in range(max(params.train.workers, len(params.train.seeds))):
        preparation.append(seconds(lambda seed=seed: cells.append(prepare_cell(problem, seed))))
    found = differences(cells[0])
    if not max(found.values()) < TOLERANCE:
        raise AssertionError(f"{model}: ours and the baseline differ by {found}; at most {TOLERANCE} is allowed.")
    ms = measure(bnn_cases(cells, params, steps), steps, repeats)
    amortised = {name: 1e3 * statistics.median(preparation) / total for name, total in TRAININGS.items()}
    whole = {
        name: ratio({**ms, "whole": [t + extra for t in ms["ours"]]}, "whole", "baseline")
        for name, extra in amortised.items()
    }
    return {
        "relative_difference": found,
        "ms_per_model_and_step": {name: spread(values) for name, values in ms.items()},
        "preparation_s": spread(preparation),
        "preparation_ms_per_step": amortised,
        "ratio_ours_to_baseline": ratio(ms, "ours", "baseline"),
        "ratio_ours_with_preparation_to_baseline": whole,
        "ratio_seeds_batched_to_in_turn": ratio(ms, "seeds batched", "seeds in turn"),
    }


def benchmark_sim_model(params: Params, steps: int, repeats: int) -> dict[str, Any]:
    """SIM-MODEL, for the whole grid's time only: full batches, of the grid's mean N."""
    spot, workers = Spot(1 / params.transitions.nominal_rate_hz), params.train.workers
    data = synthetic_transitions(jax.random.key(0), round(statistics.mean(params.train.sample_sizes)), spot)
    config = dataclasses.replace(params.train.sim_model, training_steps=steps, evaluate_every=steps)
    cases = {}
    for noise in params.train.noises:
        fit = partial(identify.identify, spot, data, config, FAMILIES[noise], no_report)
        cases[f"threads, {noise}"] = Case(partial(side_by_side, [fit] * workers), workers)
    ms = measure(cases, steps, repeats)
    return {"ms_per_model_and_step": {name: spread(values) for name, values in ms.items()}}


def no_report(_step: int, _metrics: dict[str, float]) -> None:
    """A report that nobody reads."""


# The whole grid


def grid_minutes(params: Params, figures: Mapping[str, Any]) -> dict[str, float]:
    """Minutes for all cells by model, no cell stopped early, `workers` side by side.

    The preparations are added as if only one at a time could run: an upper bound.
    """
    minutes: dict[str, float] = dict.fromkeys(params.train.models, 0.0)
    for cell in grid(params.train):
        measured = figures[cell.method]  # with a diagnosed simulator it steps like its twin
        ms = measured["ms_per_model_and_step"][f"threads, {cell.noise}"]["median"]
        preparation = measured.get("preparation_s", {"median": 0.0})["median"]
        minutes[cell.model] += (ms / 1e3 * steps_at_most(cell, params.train) + preparation) / 60
    return {**minutes, "all": sum(minutes.values())}


# Report


def processor() -> str:
    """The processor's name."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def machine() -> dict[str, Any]:
    """What the figures depend on; the load average [processes] is that of the minute before the start."""
    return {
        "processor": processor(),
        "cpus": os.cpu_count(),
        "load_before": os.getloadavg()[0],
        "platform": platform.platform(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "device": str(jax.devices()[0].device_kind),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }


def table(results: Mapping[str, Any]) -> str:
    """All figures, a line each: median, then least and greatest."""
    lines = [f"{'':58}{'median':>10}{'min':>10}{'max':>10}"]

    def row(name: str, values: Mapping[str, float]) -> None:
        lines.append(f"{name:58}" + "".join(f"{values[k]:10.3f}" for k in ("median", "min", "max")))

    for model, figures in results["models"].items():
        for case, values in figures["ms_per_model_and_step"].items():
            row(f"{model}: {case} [ms per model and step]", values)
        if "preparation_s" not in figures:
            continue
        row(f"{model}: preparation [s]", figures["preparation_s"])
        for name, value in figures["preparation_ms_per_step"].items():
            lines.append(f"{f'{model}: preparation, {name} [ms per step]':58}{value:10.3f}")
        row(f"{model}: ours / baseline", figures["ratio_ours_to_baseline"])
        for name, values in figures["ratio_ours_with_preparation_to_baseline"].items():
            row(f"{model}: ours with preparation, {name} / baseline", values)
        row(f"{model}: seeds batched / in turn", figures["ratio_seeds_batched_to_in_turn"])
    for model, minutes in results["grid_minutes"].items():
        lines.append(f"{f'whole grid, {model} [min]':58}{minutes:10.1f}")
    return "\n".join(lines)


def count(text: str) -> int:
    """An argument that must be a whole number above 0."""
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"{value} is given; it must be at least 1.")
    return value


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.training", description="Speed of training.")
    parser.add_argument("--steps", type=count, default=500, help="training steps of one measurement")
    parser.add_argument("--repeats", type=count, default=7, help="measurements of each case")
    options = parser.parse_args()
    params = load_params(ROOT / "params.yaml")
    results: dict[str, Any] = {"machine": machine(), "steps": options.steps, "repeats": options.repeats}
    models = {"sim_model": benchmark_sim_model(params, options.steps, options.repeats)}
    for model in ("fsvgd", "sim_fsvgd"):
        models[model] = benchmark_bnn(model, params, options.steps, options.repeats)
    results |= {
        "sample_size": SAMPLE_SIZE,
        "trainings": TRAININGS,
        "workers": params.train.workers,
        "models": models,
        "grid_minutes": grid_minutes(params, models),
    }
    print(table(results))
    OUTPUT.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
