"""From N transitions to the model: fit the simulator, choose the residual's prior, train, choose the pace."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from simgap import fsvgd
from simgap.noise import NoiseFamily
from simgap.residual import body, duration, pace
from simgap.residual.config import Config
from simgap.residual.fit import Fitted, fit
from simgap.residual.model import ResidualModel
from simgap.residual.train import Rows, Settings, State, train, validate
from simgap.types import DivergenceError, Recording, Report, Simulator, Transitions


class _Units(NamedTuple):
    """What features and residuals are measured in."""

    feature_mean: Float[Array, " f"]
    feature_std: Float[Array, " f"]
    unit: Float[Array, " s"]


def residual_model(
    key: PRNGKeyArray,
    data: Transitions,
    sessions: Sequence[Recording],
    simulator: Simulator,
    settings: tuple[Config, fsvgd.Config, NoiseFamily],
    report: Report,
) -> ResidualModel:
    """The model of N transitions, `data`, whose long predictions keep the pace of `sessions`.

    The prior's scales and the number of steps are those with which a residual learnt without some of the sessions of
    `data` predicts these best; then it is learnt from all. `report` gets train_nll of the fit and validation_nll, in
    original units, step after step of all trainings. Raises DivergenceError when an NLL leaves the finite numbers.
    """
    config, bnn, noise = settings
    key_fit, key_held, key_choice, key_train = jax.random.split(key, 4)
    fitted = fit(key_fit, (data.x, data.y), simulator, config, noise, report)
    units, rows = _prepare(data, simulator, fitted, noise)
    held = heldout(key_held, data.session, config.heldout_share)
    parts = tuple(jax.tree.map(lambda a, some=some: a[some], rows) for some in (~held, held))
    tried = [Settings(config, bnn, *scale, noise) for scale in config.scales]
    best, steps = choose(key_choice, parts, fitted, tried, report)
    state = train(key_train, rows, fitted, best, steps, lambda *_: False)
    return pace.kept(_model(simulator, fitted, units, state, noise), sessions, config)


def choose(
    key: PRNGKeyArray, parts: tuple[Rows, ...], fitted: Fitted, tried: Sequence[Settings], report: Report
) -> tuple[Settings, int]:
    """Settings and steps of the least NLL of the second part's rows, learnt from the first part's."""
    training, held = parts
    best, best_steps, best_nll = tried[0], 0, np.inf
    for i, settings in enumerate(tried):
        curve: dict[int, float] = {}
        before = settings.own.simulator_steps + i * settings.own.training_steps

        def watch(
            done: int, state: State, curve: dict[int, float] = curve, before: int = before, of: Settings = settings
        ) -> bool:
            curve[done] = float(validate(state, held, fitted, of.noise))
            report(before + done, {"validation_nll": curve[done]})
            return done - min(curve, key=curve.__getitem__) >= of.own.patience

        train(key, training, fitted, settings, settings.own.training_steps, watch)
        steps = min(curve, key=curve.__getitem__)
        if curve[steps] < best_nll:
            best, best_steps, best_nll = settings, steps, curve[steps]
    if not np.isfinite(best_nll):
        raise DivergenceError(f"every residual diverged: NLL {best_nll} at best. Lower bnn.learning_rate.")
    return best, best_steps


def heldout(key: PRNGKeyArray, sessions: Int[Array, " n"], share: float) -> Bool[np.ndarray, " n"]:
    """Rows of whole sessions, drawn until they are such a share; of the rows' last where there is one session."""
    session = np.asarray(sessions)
    names = np.unique(session)
    if len(names) == 1:
        return np.arange(len(session)) >= (1 - share) * len(session)
    held = np.zeros(len(session), bool)
    for name in np.asarray(jax.random.permutation(key, jnp.asarray(names)))[:-1]:
        held |= session == name
        if held.mean() >= share:
            break
    return held


@partial(jax.jit, static_argnames="simulator")
def _simulate(
    x: Float[Array, "n x"], simulator: Simulator, params: Float[Array, " p"], durations: Float[Array, " q"]
) -> tuple[Array, Array, Array]:
    """Features, outputs after each duration, directions of the residual; of every row."""

    def one(x: Array) -> tuple[Array, Array, Array]:
        simulated = duration.after(duration.path(simulator, params, x), durations)
        return body.features(simulator, x), simulated, body.lift(simulator.schema, x)

    return jax.vmap(one)(x)


def _prepare(data: Transitions, simulator: Simulator, fitted: Fitted, noise: NoiseFamily) -> tuple[_Units, Rows]:
    """Rows for training. A residual's unit is its median absolute deviation, as a standard deviation, about its median,
    each row having its likeliest duration."""
    features, simulated, lift = _simulate(data.x, simulator, fitted.params, fitted.durations)
    apart = data.y[:, None] - simulated
    likeliest = noise.log_density(fitted.noise, apart / fitted.y_std).sum(-1).argmax(1)
    missed = apart[jnp.arange(len(apart)), likeliest] / fitted.durations[likeliest][:, None]
    along = jnp.einsum("nys,ny->ns", lift, missed)
    deviation = 1.4826 * jnp.median(jnp.abs(along - jnp.median(along, 0)), 0)
    std = features.std(0)
    units = _Units(features.mean(0), jnp.where(std > 1e-6, std, 1.0), jnp.maximum(deviation, 1e-9))
    return units, Rows(
        (features - units.feature_mean) / units.feature_std,
        simulated / fitted.y_std,
        lift * units.unit / fitted.y_std[:, None],
        data.y / fitted.y_std,
    )


def _model(simulator: Simulator, fitted: Fitted, units: _Units, state: State, noise: NoiseFamily) -> ResidualModel:
    scale, dof = fitted.y_std * noise.scale(state.noise), noise.dof(state.noise)
    one = jnp.ones(())
    return ResidualModel(simulator, fitted.params, fitted.durations, one, one, state.particles, *units, scale, dof)
