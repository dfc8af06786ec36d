"""What the benchmark of training learns, and how this project trains it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from benchmarks.timing import Job
from simgap import fsvgd, priors
from simgap.domain import uniform_inputs
from simgap.noise import NoiseFamily, gaussian
from simgap.recordings import HISTORY, Normalisation, encode_state, normalisation, normalise
from simgap.simulators import normalised_functions, parameter_ranges, sample_parameters, state_difference
from simgap.simulators.spot import Spot
from tasks.params import Params

SAMPLE_SIZE = 2000
# Spot in its own frame: base pose [m, m, rad], base velocity [m/s, m/s, rad/s], hand from the base [m], its velocity
# [m/s]; commands [m/s, rad/s].
STATE_LOW = (-2.0, -2.0, -3.0, -1.0, -1.0, -1.0, 0.5, -0.3, 0.2, -0.5, -0.5, -0.5)
STATE_HIGH = (2.0, 2.0, 3.0, 1.0, 1.0, 1.0, 0.9, 0.3, 0.8, 0.5, 0.5, 0.5)
COMMAND_HIGH = 1.0
NOISE_STD = 0.05
"""Standard deviation of the outputs' noise, in units of each output's own."""


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
