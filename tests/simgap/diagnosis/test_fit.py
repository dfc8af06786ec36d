"""The fit finds what was planted, as surely as it says; noise is told by scale and tails."""

from dataclasses import dataclass

import numpy as np
import pytest
from planted import PHI, SCALES, SPOT, theta
from scipy import stats
from small import KEYS, RICH, acting, problem, sessions

from examples.drive import PARAMETERS, SCHEMA
from simgap.diagnosis.config import Z95
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.hypotheses.support import From, opened
from simgap.diagnosis.inference.fitting.gauss_newton import hold, lowest, optimise, refine
from simgap.diagnosis.inference.fitting.model import Model, decorrelated
from simgap.diagnosis.inference.search import posterior
from simgap.diagnosis.likelihood.derivatives import constant_columns, nuisance_columns
from simgap.diagnosis.likelihood.directions import directions
from simgap.diagnosis.likelihood.problem import Group, Problem, evaluate, start, trials, value_of, whitening, with_value
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.student_t import Noise, fit_noise, log_density, weights
from simgap.diagnosis.likelihood.variables import Variables
from simgap.effects import CATALOGUE
from simgap.effects.augmented import Augmented, Slot
from simgap.effects.regime import Regime, features
from simgap.types import DivergenceError, Parameter, Recording, Schema, Sessions


def fitted(training: list[Recording], groups: tuple[Group, ...] = ()) -> Model:
    of = problem(training)
    begun = evaluate(of, start(of), groups)
    of = of._replace(whiten=whitening(begun.e))
    return decorrelated(of, optimise(of, evaluate(of, begun.v, groups))[0])


def group(key: str, sites: tuple[int, ...]) -> Group:
    e = [effect.key for effect in CATALOGUE].index(key)
    (effect,) = (effect for effect in CATALOGUE if effect.key == key)
    size = min(abs(first) for first, *_ in effect.starts(SCALES, sites[0]))
    return Group(tuple(SPOT.index[Slot(e, 0, s)] for s in sites), size)


# Parameters


@pytest.mark.parametrize("seed", [0, 1])
def test_parameters_of_a_null_are_found_within_their_own_intervals(seed: int) -> None:
    rng = np.random.default_rng(seed)
    planted = PHI.copy()
    planted[:6] *= rng.uniform(0.7, 1.2, 6)
    planted[18:] = rng.uniform(0.95, 1.6, 6)
    training, _ = sessions({}, seed=20 + seed, phi=planted)
    model = fitted(training)
    sd = posterior.spread(model.problem, model.fit, model.nuisance).phi
    z = (np.asarray(model.fit.v.phi) - planted) / sd
    assert np.abs(z).max() < 4
    assert (np.abs(z) < Z95).mean() > 0.8
    # And they are intervals worth having: the memories' and the advances'.
    assert (sd[:6] < 0.05).all()
    assert (sd[18:] < 0.05).all()


def test_a_constant_is_found_within_its_own_interval() -> None:
    training, _ = sessions(acting("delay", (1.4,), (0, 1, 2)), seed=5)
    model = fitted(training, (group("delay", (0, 1, 2)),))
    sd = posterior.spread(model.problem, model.fit, model.nuisance).constants
    found = np.asarray(model.fit.v.theta)
    np.testing.assert_array_equal(found[[i for i in range(len(found)) if i not in model.fit.groups[0].entries]], 0)
    rows = found[list(model.fit.groups[0].entries)]
    assert np.ptp(rows) == 0  # one constant, shared
    assert abs(rows[0] - 1.4) < 4 * sd[0]
    assert sd[0] < 0.1


def test_constants_stay_within_their_bounds() -> None:
    training, _ = sessions(acting("viscous_drag", (0.0,)), seed=6)
    free = (group("coulomb_friction", (0,)), group("viscous_drag", (0,)), group("saturation", (0,)))
    model = fitted(training, free)
    low, high = SPOT.bounds
    found = np.asarray(model.fit.v.theta)
    assert (found >= low).all()
    assert (found <= high).all()


def test_constants_behind_a_support_stay_within_their_bounds() -> None:
    """Of an effect that acts only from a time on, and of the sum where it also acts everywhere."""
    training, _ = sessions({}, seed=6)
    of = problem(training)
    of = of._replace(chunks=opened(SPOT.layout, of.chunks, [From(5.0)]))
    keys = ("coulomb_friction", "viscous_drag", "saturation", "rate_limit", "deadband", "lag")
    everywhere = tuple(group(key, (0,)) for key in keys)
    later = tuple(g._replace(support=1) for g in everywhere)
    low, high = SPOT.bounds
    for groups in (later, (*everywhere, *later)):
        fit, _ = optimise(of, evaluate(of, start(of), groups))
        found = np.asarray(fit.v.theta) + np.asarray(fit.v.delta[0])
        assert (found >= low - 1e-6).all()
        assert (found <= high + 1e-6).all()


@pytest.mark.parametrize(
    ("key", "value", "names"),
    [("integration_rule", -1.5, False), ("integration_rule", -1.0, True), ("integration_rule", 1.5, False),
     ("gain", 2.0, False), ("gain", 0.5, True), ("delay", 8.0, False), ("delay", 2.0, True)],
)  # fmt: skip
def test_a_constant_at_a_bound_names_nothing(key: str, value: float, names: bool) -> None:
    """Bounds lie beyond what a robot does: a fit that goes there has found something else."""
    of = problem(sessions({}, seed=6)[0])
    hypothesis = next(c for c in hypotheses_of(SPOT, of.scales) if c.effect.key == key)
    v = start(of)
    for g in hypothesis.groups:
        v = with_value(v, g, value)
    fit = evaluate(of, v, hypothesis.groups)
    sd = posterior.Spread(np.zeros(24), np.full(len(hypothesis.groups), 0.01), np.ones(24, bool))
    assert posterior.differs_from_zero(of, fit, hypothesis, sd) == names
    assert posterior.determined(of, fit, hypothesis, sd, 100.0) == names


def test_every_step_of_the_fit_is_an_improvement() -> None:
    training, _ = sessions({}, seed=7)
    of = problem(training)
    of = of._replace(whiten=whitening(evaluate(of, start(of), ()).e))
    begun = evaluate(of, start(of), ())
    held = hold(begun, nuisance_columns(of, begun.v))
    logliks = [begun.loglik, *(refine(of, begun, held, steps).loglik for steps in (1, 3))]
    logliks.append(optimise(of, begun)[0].loglik)
    assert logliks == sorted(logliks)
    assert logliks[-1] > logliks[0] + 50


def test_wherever_the_gain_starts_the_fit_is_as_good_in_the_end() -> None:
    training, _ = sessions({}, seed=7)
    of = problem(training)
    of = of._replace(whiten=whitening(evaluate(of, start(of), ()).e))
    inside = start(of)
    outside = inside._replace(gain=np.ones(12, np.float32))
    a, b = (optimise(of, evaluate(of, v, ()))[0].loglik for v in (inside, outside))
    assert a == pytest.approx(b, abs=2.0)


def test_a_step_ends_where_its_quadratic_is_lowest_within_bounds() -> None:
    """Not where a longer one is cut: with the first at its bound, the second goes along with it no more."""
    hessian, gradient = np.array([[1.0, 0.9], [0.9, 1.0]]), np.array([-1.0, 0.0])
    step = lowest(hessian, gradient, np.array([-1.0, -np.inf]), np.array([0.5, np.inf]))
    np.testing.assert_allclose(step, [0.5, -0.45], atol=1e-6)
    np.testing.assert_allclose(
        lowest(hessian, gradient, np.full(2, -np.inf), np.full(2, np.inf)), np.linalg.solve(hessian, -gradient)
    )


def test_a_direction_that_rounding_has_bent_down_is_gone_along_within_bounds() -> None:
    """Two directions that are one: in 32 bits their products may have a negative curvature."""
    hessian, gradient = np.array([[1.0, 1 + 1e-7], [1 + 1e-7, 1.0]]), np.array([-1.0, -1.0])
    step = lowest(hessian, gradient, np.full(2, -5.0), np.full(2, 5.0))
    assert step.sum() == pytest.approx(1.0, abs=1e-5)


# Derivatives


def test_columns_are_derivatives_of_the_decorrelated_innovations() -> None:
    training, _ = sessions({}, seed=8)
    of = problem(training)
    of = of._replace(whiten=whitening(evaluate(of, start(of), ()).e))
    v = start(of)._replace(theta=theta(acting("gain", (0.1,), (0,))))
    groups = (group("gain", (0,)), group("delay", (3, 4, 5)))
    columns = np.concatenate([nuisance_columns(of, v), constant_columns(of, v, groups)])
    free, precision = directions(of, groups)
    assert len(columns) == len(precision) == 24 + 12 + 44 + 2
    (e,) = trials(of, [v])
    rng = np.random.default_rng(0)
    along = rng.normal(size=len(columns)) * 1e-3
    along[-1] = abs(along[-1])  # a dead time is at its bound
    moved = Variables(*(a + np.tensordot(along.astype(np.float32), d, 1) for a, d in zip(v, free, strict=True)))
    change, expected = trials(of, [moved])[0] - e, np.tensordot(along, columns, 1)
    assert np.linalg.norm(change - expected) < 0.05 * np.linalg.norm(change)


@pytest.mark.long
def test_two_effects_that_act_in_two_regimes_are_fitted_at_the_same_time() -> None:
    names = [f.name for f in features(SPOT.layout)]
    far, turning = Regime(names.index("reach"), 1.0, 0.8), Regime(names.index("base |yaw rate|"), 1.0, 0.3)
    weak, dragged = acting("gain", (-0.35,), (4,)), acting("viscous_drag", (0.35,), (1,))
    of = problem(sessions({}, RICH, during=weak, regime=far, there=dragged, its_regime=turning)[0])
    of = of._replace(chunks=opened(SPOT.layout, of.chunks, [far, turning]))
    of = of._replace(whiten=whitening(evaluate(of, start(of), ()).e))
    groups = (group("gain", (4,))._replace(support=1), group("viscous_drag", (1,))._replace(support=2))
    fit, _ = optimise(of, evaluate(of, start(of), groups))
    assert [value_of(fit.v, g) for g in groups] == pytest.approx([-0.35, 0.35], rel=0.15)
    one, _ = optimise(of, evaluate(of, start(of), groups[:1]))
    assert fit.loglik > one.loglik + 50


# Noise


@pytest.mark.parametrize(("scale", "dof"), [(0.7, 3.0), (0.02, 5.0), (40.0, 10.0)])
def test_scale_and_tails_of_noise_are_found(scale: float, dof: float) -> None:
    e = np.stack([stats.t.rvs(dof, scale=s * scale, size=20000, random_state=k) for k, s in enumerate((1, 3))], axis=1)
    noise = fit_noise(e)
    np.testing.assert_allclose(noise.scale, [scale, 3 * scale], rtol=0.05)
    assert (noise.dof >= 0.7 * dof).all()
    assert (noise.dof <= 1.45 * dof).all()


def test_gaussian_noise_has_no_tails() -> None:
    noise = fit_noise(np.random.default_rng(0).normal(size=(20000, 2)) * [0.5, 2.0])
    np.testing.assert_array_equal(noise.dof, 60)
    np.testing.assert_allclose(noise.scale, [0.5, 2.0], rtol=0.03)


def test_log_density_is_scipys() -> None:
    e = np.random.default_rng(0).normal(size=(50, 2))
    noise = Noise(np.array([0.5, 2.0]), np.array([3.0, 20.0]))
    np.testing.assert_allclose(log_density(e, noise), stats.t.logpdf(e, noise.dof, scale=noise.scale), rtol=1e-10)


def test_weights_are_the_slope_of_the_density() -> None:
    e = np.linspace(-3, 3, 31)[:, None] + 0.01
    noise = Noise(np.array([0.5]), np.array([4.0]))
    slope = (log_density(e + 1e-6, noise) - log_density(e - 1e-6, noise)) / 2e-6
    np.testing.assert_allclose(-weights(e, noise) * e, slope, rtol=1e-6, atol=1e-8)


# Whitening


@pytest.mark.parametrize("outliers", [0, 20])
def test_whitened_output_is_uncorrelated_with_unit_scale(outliers: int) -> None:
    rng = np.random.default_rng(1)
    mixing = np.array([[1e-3], [1.0], [30.0], [1.0], [1.0]]) * (rng.normal(size=(5, 5)) + 5 * np.eye(5))
    e = rng.normal(size=(4000, 5)) @ mixing.T
    e[:outliers] *= 100
    white = (e @ whitening(e).T)[outliers:]
    np.testing.assert_allclose(np.cov(white.T), np.eye(5), atol=0.1)


def test_whitening_bears_outputs_that_never_change() -> None:
    e = np.random.default_rng(1).normal(size=(500, 3)) * [1.0, 0.0, 2.0]
    white = e @ whitening(e).T
    assert np.isfinite(white).all()
    np.testing.assert_allclose(white[:, [0, 2]].std(0), 1, atol=0.1)


# Divergence


@dataclass(frozen=True)
class Explosive:
    """A drive that leaves the finite numbers within a few steps."""

    time_step: float = 0.02
    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = PARAMETERS

    def step(self, params, state, command):
        return state * 1e30 + params[0] * command[0] + 1e20


def drives() -> list[Recording]:
    rng = np.random.default_rng(0)
    time_s = np.arange(100) * 0.02
    return [Recording(str(k), time_s, rng.normal(size=(100, 2)), rng.normal(size=(100, 1))) for k in range(4)]


def test_a_diverging_simulator_is_told() -> None:
    augmented, recorded = Augmented(Explosive()), drives()
    of = Problem(augmented, measure(augmented, recorded), cut(recorded, 0.02), np.eye(2))
    with pytest.raises(DivergenceError, match="diverges"):
        optimise(of, evaluate(of, start(of), ()))


def test_a_diverging_simulator_is_told_by_the_diagnosis() -> None:
    recorded = drives()
    with pytest.raises(DivergenceError, match="diverges"):
        diagnose(Explosive(), "explosive", Sessions(recorded[:3], recorded[3:]))


def test_keys_are_known() -> None:
    assert set(KEYS) == {effect.key for effect in CATALOGUE}
