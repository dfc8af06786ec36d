"""Every fitted parameter stays within its declared range, and one at the edge of it is reported."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from examples.drive import PARAMETERS, Drive
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.fitting.model import Model
from simgap.diagnosis.inference.search import posterior
from simgap.diagnosis.likelihood.problem import Problem, evaluate, start, whitening
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.effects.augmented import Augmented
from simgap.types import Parameter, Recording, Sessions


def driven(
    params: tuple[float, float], seed: int = 0, sessions: int = 4, rows: int = 150, friction: float = 0.0
) -> list[Recording]:
    """Sessions of a drive with a mass [kg], a damping [N s/m] and a dry friction [N], under forces that change at
    random."""
    rng, drive = np.random.default_rng(seed), Drive()
    h, (mass, damping) = drive.time_step, params
    k = h * damping / (2 * mass)
    recordings = []
    for s in range(sessions):
        force = np.repeat(rng.normal(0, 8, rows // 10), 10)
        state = np.zeros((rows, 2))
        for t in range(rows - 1):
            p, v = state[t]
            then = ((1 - k) * v + h * force[t] / mass) / (1 + k)
            then = np.sign(then) * max(abs(then) - h * friction / mass, 0.0) + rng.normal(0, 0.004)
            state[t + 1] = p + h * (v + then) / 2, then
        seen = state + rng.normal(0, [0.001, 0.004], state.shape)
        recordings.append(Recording(f"s{s}", np.arange(rows) * h, seen, force[:, None]))
    return recordings


def ranged(mass: tuple[float, float], damping: tuple[float, float]) -> Drive:
    """The drive with other ranges, its nominal values in the middle of them."""
    of = (
        replace(p, low=low, high=high, nominal=None) for p, (low, high) in zip(PARAMETERS, (mass, damping), strict=True)
    )
    return Drive(parameters=tuple(of))


def fitted(simulator: Drive, recordings: list[Recording]) -> Model:
    augmented = Augmented(simulator)
    of = Problem(augmented, measure(augmented, recordings), cut(recordings, simulator.time_step), np.eye(2))
    of = of._replace(whiten=whitening(evaluate(of, start(of), ()).e))
    return Model(of, *optimise(of, evaluate(of, start(of), ())))


@pytest.mark.parametrize("seed", range(4))
def test_parameters_stay_within_their_ranges_wherever_the_true_ones_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = rng.uniform(1.0, 4.0), rng.uniform(1.0, 8.0)
    # Ends that 32 bits do not have, below or above the true values.
    (a, b), (c, d) = (np.sort(value * rng.uniform(1.05, 2.5, 2) ** rng.choice([-1, 1])) for value in true)
    model = fitted(ranged((a, b), (c, d)), driven(true, seed))
    phi = np.asarray(model.fit.v.phi, np.float64)
    assert (phi >= [a, c]).all(), (phi, a, c)
    assert (phi <= [b, d]).all(), (phi, b, d)
    assert posterior.at_bound(model.problem, model.fit)


def test_a_fit_whose_ranges_do_not_bind_is_what_it_was() -> None:
    model = fitted(Drive(), driven((2.5, 5.0)))
    sd = posterior.spread(*model).phi
    assert (np.abs(np.asarray(model.fit.v.phi) - [2.5, 5.0]) < 4 * sd).all()
    assert posterior.at_bound(model.problem, model.fit) == {}


@pytest.mark.parametrize("low", [0.1, 1e-7, 0.9])
def test_ranges_in_32_bits_lie_within_the_declared_ones(low: float) -> None:
    augmented = Augmented(Drive(parameters=(Parameter("a", "", low, low * 1.7, low), Parameter("b", "", low, low))))
    (least, fixed), (most, also_fixed) = augmented.ranges
    assert low <= float(least) <= float(most) <= low * 1.7
    assert fixed == also_fixed == pytest.approx(low)
    assert augmented.nominal[0] == least


def test_a_diagnosis_says_which_parameter_is_at_the_edge_of_its_range() -> None:
    recordings = driven((2.5, 5.0))
    statement = diagnose(ranged((0.7, 1.9), (0.1, 20.0)), "drive", Sessions(recordings[:3], recordings[3:])).statement
    parameters = statement["parameters"]
    assert parameters["at_bound"] == ["mass"]
    assert 1.9 * (1 - 1e-3) <= parameters["fitted"]["mass"] <= 1.9
    assert all(0.7 <= end <= 1.9 for end in parameters["ci95"]["mass"])
    assert parameters["undetermined"] == []
    assert (
        "mass is at the edge of its range (1.9 kg): widen the range if larger values are plausible."
        in statement["notes"]
    )
    assert statement["verdict"] == "inconclusive"
    assert parameters["beyond"] == {"mass": pytest.approx(2.5, rel=0.02)}


class Known(Drive):
    """The drive with constants that are known for certain, as a falling ball has them: nothing is to be fitted."""

    parameters: tuple[Parameter, ...] = ()

    def step(self, params: Any, state: Any, command: Any) -> Any:
        del params
        return Drive().step(jnp.array([2.5, 4.0]), state, command)


@pytest.mark.long
def test_a_simulator_without_parameters_is_diagnosed() -> None:
    recordings = driven((2.5, 4.0))
    stated = diagnose(Known(parameters=()), "known", Sessions(recordings[:3], recordings[3:])).statement
    assert stated["parameters"]["nominal"] == stated["parameters"]["fitted"] == {}
    assert stated["verdict"] in ("nothing", "inconclusive")
