"""The three models of the paper, each learnt from the same N transitions: SIM-MODEL, FSVGD, Sim-FSVGD."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from simgap import fsvgd, identify, priors
from simgap.domain import uniform_inputs
from simgap.models import BNN, FittedSimulator, FittedSpot
from simgap.noise import NoiseFamily
from simgap.recordings import Normalisation, normalisation
from simgap.simulators import normalised_functions
from simgap.simulators.spot import Spot
from simgap.types import Report, Simulator


def sim_model(
    data: fsvgd.Data, simulator: Simulator, config: identify.Config, noise: NoiseFamily, report: Report
) -> FittedSpot | FittedSimulator:
    """SIM-MODEL: the simulator, fitted to all N [Hoffman et al. 2025, Baseline Models]."""
    params, scale, dof = identify.identify(simulator, data, config, noise, report)
    if type(simulator) is Spot:
        return FittedSpot(params, scale, dof, jnp.asarray(simulator.time_step))
    return FittedSimulator(simulator, params, scale, dof)


def fsvgd_model(
    key: PRNGKeyArray,
    data: fsvgd.Data,
    simulator: Simulator,
    prior: priors.Config,
    config: fsvgd.Config,
    noise: NoiseFamily,
    report: Report,
) -> BNN:
    """FSVGD: no knowledge of the robot but smoothness; of the simulator, only its coordinates are used."""
    marginals = priors.gp_marginals(data[1].shape[1], prior)
    return _infer(key, data, simulator, lambda _: marginals, prior, config, noise, report)


def sim_fsvgd_model(
    key: PRNGKeyArray,
    data: fsvgd.Data,
    simulator: Simulator,
    phi: Float[Array, "P p"],
    prior: priors.Config,
    config: fsvgd.Config,
    noise: NoiseFamily,
    report: Report,
) -> BNN:
    """Sim-FSVGD: the simulator, unfitted, with parameters phi ~ p(phi), as prior [Hoffman et al. 2025, BNN Model]."""

    def marginals(stats: Normalisation) -> priors.Marginals:
        return priors.simulator_marginals(normalised_functions(simulator, phi, stats), prior)

    return _infer(key, data, simulator, marginals, prior, config, noise, report)


def _infer(
    key: PRNGKeyArray,
    data: fsvgd.Data,
    simulator: Simulator,
    marginals: Callable[[Normalisation], priors.Marginals],
    prior: priors.Config,
    config: fsvgd.Config,
    noise: NoiseFamily,
    report: Report,
) -> BNN:
    """FSVGD with a prior that is given for the statistics of the training rows."""
    training, validation = _split(data, config.validation_share)
    stats = normalisation(*training)
    key_points, key = jax.random.split(key)
    points = _points(key_points, training, simulator, config, prior)
    return fsvgd.train(key, (training, validation), stats, points, marginals(stats), config, noise, report)


def _split(data: fsvgd.Data, share: float) -> tuple[fsvgd.Data, fsvgd.Data]:
    """Training rows and validation rows; the N are in random order already."""
    x, y = data
    count = max(1, round(share * len(x)))
    return (x[count:], y[count:]), (x[:count], y[:count])


def _points(
    key: PRNGKeyArray, training: fsvgd.Data, simulator: Simulator, config: fsvgd.Config, prior: priors.Config
) -> Float[Array, "M k x"]:
    """M sets of k samples of mu."""
    count = config.measurement_sets * prior.measurement_points
    points = uniform_inputs(key, count, training[0], simulator)
    return points.reshape(config.measurement_sets, prior.measurement_points, -1)
