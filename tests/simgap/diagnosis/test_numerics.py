"""The fit is the same in all units, and no simulator or recording, however odd, makes its numerics fail."""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
import pytest
from test_ranges import driven

from examples.drive import PARAMETERS, SCHEMA, Drive
from simgap.diagnosis.hypotheses.space import Hypothesis, hypotheses_of
from simgap.diagnosis.inference.evidence.score_test import basis_of, screen, vary
from simgap.diagnosis.inference.fitting.gauss_newton import hold, optimise, refine
from simgap.diagnosis.inference.fitting.model import Model, absorbing
from simgap.diagnosis.inference.misfit.relaxation import room
from simgap.diagnosis.inference.search import posterior
from simgap.diagnosis.inference.search.one_more import one_more
from simgap.diagnosis.likelihood.derivatives import constant_columns, nuisance_columns
from simgap.diagnosis.likelihood.problem import Problem, evaluate, start, trials, whitening
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.student_t import fit_noise
from simgap.effects.augmented import Augmented
from simgap.types import Parameter, Recording, Schema


def posed(simulator, recordings: list[Recording]) -> Problem:
    augmented, outputs = Augmented(simulator), recordings[0].state.shape[1]
    of = Problem(augmented, measure(augmented, recordings), cut(recordings, simulator.time_step), np.eye(outputs))
    return of._replace(whiten=whitening(evaluate(of, start(of), ()).e))


def optimised(of: Problem) -> Model:
    return Model(of, *optimise(of, evaluate(of, start(of), ())))


def known(of: Problem, name: str) -> Hypothesis:
    (found,) = (c for c in hypotheses_of(of.augmented, of.scales) if c.name == name)
    return found


# Units


@dataclass(frozen=True)
class InUnits:
    """The drive with lengths and masses in units so many times smaller: their numbers are as many times greater."""

    length: float
    mass: float
    time_step: float = 0.02
    schema: Schema = SCHEMA

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(replace(p, low=p.low * self.mass, high=p.high * self.mass, nominal=(p.nominal or 0.0) * self.mass)
                     for p in PARAMETERS)  # fmt: skip

    def step(self, params, state, command):
        then = Drive(self.time_step).step(params / self.mass, state / self.length, command / self.length / self.mass)
        return then * self.length

    def recorded(self, recordings: list[Recording]) -> list[Recording]:
        force = self.length * self.mass
        return [Recording(r.name, r.time_s, r.state * self.length, r.command * force) for r in recordings]


def rubbing() -> list[Recording]:
    """Sessions of a drive with dry friction of 1.5 N: its force lacks that against the motion."""
    return [r._replace(command=r.command + 1.5 * np.sign(r.state[:, 1:])) for r in driven((2.5, 5.0))]


def free(model: Model) -> np.ndarray:
    """What a model without effects absorbs."""
    return room(model, absorbing(model), ()).whole


FRICTION = "coulomb_friction on velocity"


@pytest.mark.long
@pytest.mark.parametrize(("length", "mass"), [(1e-6, 1.0), (1e6, 1.0), (1.0, 1e6), (1.0, 1e-6)])
def test_gains_and_derivatives_are_the_same_in_all_units(length: float, mass: float) -> None:
    found = []
    for units in (InUnits(1.0, 1.0), InUnits(length, mass)):
        of = posed(units, units.recorded(rubbing()))
        model, friction, drag = optimised(of), known(of, FRICTION), known(of, "viscous_drag on velocity")
        screening = screen(of, model.fit, free(model), [friction, drag], np.random.default_rng(0))
        begun = evaluate(of, vary(model.fit.v, friction, friction.starts[0]), friction.groups, model.fit.noise)
        fitted = refine(of, begun, hold(model.fit, model.nuisance), 4)
        constant = float(fitted.v.theta[friction.groups[0].entries[0]]) / (length * mass if found else 1.0)
        columns = constant_columns(of, fitted.v, (*friction.groups, *drag.groups))
        sd = posterior.spread(of, fitted, model.nuisance).constants / (length * mass if found else 1.0)
        found.append((fitted.loglik - model.fit.loglik, [s.gain for s in screening.found], constant, sd, columns))
    (gain, screened, constant, sd, columns), (gain_too, screened_too, constant_too, sd_too, columns_too) = found
    assert gain > 10
    assert gain_too == pytest.approx(gain, abs=0.1)
    np.testing.assert_allclose(screened_too, screened, rtol=0.01, atol=0.1)
    assert constant == pytest.approx(1.5, abs=4 * sd[0])
    assert constant_too == pytest.approx(constant, rel=0.01)
    np.testing.assert_allclose(sd_too, sd, rtol=0.05)
    assert np.linalg.norm(columns_too - columns) < 0.02 * np.linalg.norm(columns)


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e6])
def test_a_derivative_by_a_constant_is_that_of_its_law(unit: float) -> None:
    """A drift is proportional to its constant, so that its derivative is its change at any size."""
    units = InUnits(1.0, unit)
    of = posed(units, units.recorded(driven((2.5, 5.0))))
    drift = known(of, "body_frame_bias on velocity")
    (size,) = drift.starts[0]
    (column,) = constant_columns(of, start(of), drift.groups)
    at, there = trials(of, [start(of), vary(start(of), drift, (size,))])
    assert drift.groups[0].scale == pytest.approx(size)
    assert np.linalg.norm(column - (there - at)) < 0.01 * np.linalg.norm(column)


def test_a_change_since_a_baseline_has_its_derivative_where_it_is_negative() -> None:
    of = posed(Drive(), driven((2.5, 5.0)))
    drag = known(of, "viscous_drag on velocity")
    everywhere = vary(start(of), drag, (1.0,))
    changed = drag.groups[0]._replace(support=1)
    delta = np.zeros_like(everywhere.delta)
    delta[0, list(changed.entries)] = -0.5
    of = of._replace(chunks=of.chunks._replace(gate=np.ones_like(of.chunks.gate)))
    (column,) = constant_columns(of, everywhere._replace(delta=delta), (changed,))
    (same,) = constant_columns(of, vary(start(of), drag, (0.5,)), drag.groups)
    assert np.linalg.norm(column - same) < 0.02 * np.linalg.norm(same)


# Simulators that explode, or have no derivative


@dataclass(frozen=True)
class CubicSpring:
    """The drive on a spring that hardens with the cube of its displacement: it explodes in most of its range."""

    time_step: float = 0.02
    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = (*PARAMETERS, Parameter("cubic", "N/m^3", -1e5, 1e9, nominal=0.0))

    def step(self, params, state, command):
        return Drive(self.time_step).step(params[:2], state, command - params[2] * state[:1] ** 3)


@dataclass(frozen=True)
class Rooted:
    """The drive with a resistance by the root of the speed: a derivative that is not finite at rest."""

    time_step: float = 0.02
    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = (*PARAMETERS, Parameter("root", "", 0.0, 3.0, nominal=0.5))

    def step(self, params, state, command):
        return Drive(self.time_step).step(params[:2], state, command - params[2] * jnp.sqrt(jnp.abs(state[1:])))


@dataclass(frozen=True)
class Cliff:
    """The drive, which leaves the finite numbers at once where its last parameter is not what it is nominally."""

    time_step: float = 0.02
    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = (*PARAMETERS, Parameter("cliff", "", -1.0, 1.0, nominal=0.0))

    def step(self, params, state, command):
        return Drive(self.time_step).step(params[:2], state, command) + jnp.where(params[2] == 0, 0.0, jnp.inf)


def test_a_spring_that_explodes_within_its_range_is_fitted() -> None:
    model = optimised(posed(CubicSpring(), driven((2.5, 5.0))))
    assert np.isfinite(model.fit.loglik)
    sd = posterior.spread(*model)
    assert np.isfinite(sd.phi).all()
    assert (np.abs(np.asarray(model.fit.v.phi)[:2] - [2.5, 5.0]) < 4 * sd.phi[:2]).all()
    found = one_more(
        model, hypotheses_of(model.problem.augmented, model.problem.scales), np.random.default_rng(0), print
    )
    assert all(np.isfinite(t.gain) for t in found.tried)


def test_a_derivative_that_is_not_finite_at_some_rows_is_a_difference() -> None:
    rest = [r._replace(state=r.state * (np.arange(len(r.state)) > 20)[:, None]) for r in driven((2.5, 5.0))]
    of = posed(Rooted(), rest)
    columns = nuisance_columns(of, start(of))
    assert np.isfinite(columns).all()
    assert (np.abs(columns[:3]).max((1, 2)) > 0).all()
    model = optimised(of)
    assert posterior.spread(*model).seen.all()
    assert model.fit.loglik > evaluate(of, start(of), ()).loglik


def test_a_parameter_without_a_finite_derivative_stays_where_it_is_and_is_reported() -> None:
    model = optimised(posed(Cliff(), driven((2.5, 5.0))))
    assert float(model.fit.v.phi[2]) == 0.0
    sd = posterior.spread(*model)
    np.testing.assert_array_equal(sd.seen, [True, True, False])
    assert (np.abs(np.asarray(model.fit.v.phi)[:2] - [2.5, 5.0]) < 4 * sd.phi[:2]).all()


def test_hypotheses_with_which_the_simulator_explodes_are_named() -> None:
    model = optimised(posed(Drive(), driven((2.5, 5.0))))
    of, drag = model.problem, known(model.problem, "viscous_drag on velocity")
    explosive = drag._replace(starts=((1e30,),), where="explosive")
    found = screen(of, model.fit, free(model), [drag, explosive], np.random.default_rng(0))
    assert found.untested == (explosive.name,)
    assert {s.hypothesis.name for s in found.found} == {drag.name}


# Recordings with little in them


@pytest.mark.parametrize("rows", [1, 2, 5])
@pytest.mark.parametrize("sessions", [1, 3])
def test_few_rows_are_no_error(rows: int, sessions: int) -> None:
    short = [Recording(r.name, r.time_s[:rows], r.state[:rows], r.command[:rows]) for r in driven((2.5, 5.0))]
    model = optimised(posed(Drive(), short[:sessions]))
    assert np.isfinite(model.fit.loglik)
    sd = posterior.spread(*model)
    assert np.isfinite(sd.phi).all()
    found = one_more(
        model, hypotheses_of(model.problem.augmented, model.problem.scales), np.random.default_rng(0), print
    )
    assert np.isfinite([found.screening.p_value, found.screening.threshold]).all()
    assert found.tried == []


@pytest.mark.parametrize("still", ["state", "command", "both"])
def test_columns_that_never_change_are_no_error(still: str) -> None:
    recordings = driven((2.5, 5.0))
    if still != "command":
        recordings = [r._replace(state=0 * r.state + [0.3, 0.0]) for r in recordings]
    if still != "state":
        recordings = [r._replace(command=0 * r.command) for r in recordings]
    model = optimised(posed(Drive(), recordings))
    assert np.isfinite(model.fit.loglik)
    assert np.isfinite(posterior.spread(*model).phi).all()
    every = hypotheses_of(model.problem.augmented, model.problem.scales)
    assert all(np.isfinite(c.starts).all() for c in every)
    assert np.isfinite(one_more(model, every, np.random.default_rng(0), print).screening.threshold)


def test_absurd_innovations_are_no_error() -> None:
    e = np.random.default_rng(0).normal(size=(200, 2)).astype(np.float32)
    e[3] = 1e30
    noise = fit_noise(e)
    assert np.isfinite(noise.scale).all()
    np.testing.assert_allclose(noise.scale, 0.9, atol=0.3)
    e[4] = np.nan
    np.testing.assert_array_equal(whitening(e), np.eye(2))


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_whitening_and_noise_of_few_rows_are_finite(rows: int) -> None:
    e = np.random.default_rng(0).normal(size=(rows, 3)).astype(np.float32)
    assert np.isfinite(whitening(e)).all()
    assert all(np.isfinite(a).all() for a in fit_noise(e))


def test_a_basis_leaves_out_what_is_zero() -> None:
    rows = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]], np.float32)
    np.testing.assert_allclose(np.abs(basis_of(rows)), [[1.0], [0.0], [0.0]], atol=1e-6)
    assert basis_of(np.zeros((2, 3), np.float32)).shape == (3, 0)
