"""A speed sensor that shows the size and not the sign, as of a belt that two motors drive either way."""

from dataclasses import dataclass

import numpy as np
import pytest
from jaxtyping import Array, Float

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.likelihood.problem import Problem, estimates, evaluate, start
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import RUN_IN, cut
from simgap.diagnosis.likelihood.signs import signed
from simgap.effects.augmented import Augmented
from simgap.effects.regime import Acting
from simgap.simulators.augmented import AugmentedSimulator
from simgap.types import Field, Parameter, Recording, Schema, Sessions

ROWS, FINER = 300, 10
STRENGTH, DECAY, NOISE = 80.0, 6.0, 0.3
SCHEMA = Schema(
    (Field("speed", "rad/s", "velocity", "body", "belt", "yaw"),),
    (Field("volts", "V", "force", "body", "belt", "yaw"),),
)


@dataclass(frozen=True)
class Belt:
    """The speed [rad/s] of a belt, w' = a u - b w."""

    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = (
        Parameter("strength", "rad/s^2/V", 5.0, 200.0, nominal=50.0),
        Parameter("decay", "1/s", 0.5, 20.0, nominal=4.0),
    )
    time_step: float = 0.02

    def step(self, params: Float[Array, " 2"], state: Float[Array, " 1"], command: Float[Array, " 1"]) -> Array:
        a, b = params
        return state + self.time_step * (a * command - b * state)


def session(rng: np.random.Generator, rectified: bool, lowest: float = -1.5) -> Recording:
    """Voltages that are held for a while, in steps far finer than a row."""
    volts = np.repeat(rng.uniform(lowest, 1.5, ROWS // 15), 15)
    speed, speeds = 0.0, []
    for u in volts:
        speeds.append(speed)
        for _ in range(FINER):
            speed += Belt().time_step / FINER * (STRENGTH * u - DECAY * speed)
    shown = np.abs(speeds) if rectified else np.array(speeds)
    measured = shown[:, None] + NOISE * rng.standard_normal((ROWS, 1))
    return Recording(f"session_{rng.integers(10**6)}", Belt().time_step * np.arange(ROWS), measured, volts[:, None])


def recorded(rectified: bool, seed: int = 0, **more: float) -> Sessions:
    """Three sessions to fit, one held out."""
    rng = np.random.default_rng(seed)
    recordings = [session(rng, rectified, **more) for _ in range(4)]
    return Sessions(recordings[:3], recordings[3:])


@pytest.fixture(scope="module")
def diagnosis():
    return diagnose(Belt(), "belt", recorded(rectified=True))


@pytest.mark.long
def test_a_lost_sign_is_named_though_parameters_may_hide_it(diagnosis) -> None:
    """Without it, the best strength is nearly zero: then the voltage says nothing of the speed, nor does its sign."""
    (named,) = diagnosis.statement["effects"]
    assert (named["id"], named["where"]) == ("rectified_sensor", "speed")
    (ratio,) = named["constants"]
    low, high = ratio["ci95"]
    assert low < 1.0 < high
    assert high - low < 0.1


@pytest.mark.long
def test_forecasts_begin_with_the_sign_that_the_rows_before_them_show(diagnosis) -> None:
    models = diagnosis.statement["fit"]["models"]
    assert models["augmented"]["error_50"]["value"] < 0.2 * models["refitted"]["error_50"]["value"]


@pytest.mark.parametrize(("rectified", "lowest"), [(False, -1.5), (True, 0.0)])
def test_sensors_that_show_the_sign_or_speeds_that_have_only_one_are_not_blamed(rectified: bool, lowest: float) -> None:
    statement = diagnose(Belt(), "belt", recorded(rectified, seed=1, lowest=lowest)).statement
    assert statement["found"] == []


def rectifying(augmented: Augmented, sessions: Sessions) -> tuple[Problem, np.ndarray]:
    """The problem, and theta with a sensor without sign."""
    problem = Problem(augmented, measure(augmented, sessions.fitted), cut(sessions.fitted, 0.02), np.eye(1))
    return problem, augmented.folding.astype(np.float32)


def test_segments_begin_with_the_sign_of_the_speed() -> None:
    signs = recorded(rectified=False, seed=2)
    lost = Sessions([r._replace(state=np.abs(r.state)) for r in signs.fitted], [])
    problem, theta = rectifying(Augmented(Belt()), lost)
    v = start(problem)._replace(theta=theta, phi=np.array([STRENGTH, DECAY], np.float32))
    begun = signed(problem, v)
    first = lambda chunks: np.asarray(chunks.state)[:, 0, 0]  # noqa: E731
    true, shown = first(cut(signs.fitted, Belt().time_step)), first(begun.chunks)
    clear = np.asarray(problem.chunks.counts).any(1) & (np.abs(true) > 1)
    assert (true[clear] < 0).sum() > 3
    np.testing.assert_array_equal(np.sign(shown[clear]), np.sign(true[clear]))
    # Estimates then have the sign throughout.
    rows = slice(RUN_IN, 4 * RUN_IN)
    assert np.abs(estimates(begun, v)[0, rows, 0] - signs.fitted[0].state[rows, 0]).max() < 5 * NOISE
    assert evaluate(begun, v, ()).loglik > evaluate(problem, v, ()).loglik + 10


def test_nothing_changes_unless_a_sensor_loses_the_sign() -> None:
    problem, _ = rectifying(Augmented(Belt()), recorded(rectified=True))
    assert signed(problem, start(problem)) is problem


def test_the_corrected_simulator_keeps_the_sign_for_its_next_step() -> None:
    augmented = Augmented(Belt())
    _, theta = rectifying(augmented, recorded(rectified=True))
    scales = measure(augmented, recorded(rectified=True).fitted)
    simulator = AugmentedSimulator.of(Belt(), Acting(theta, np.zeros((0, len(theta)), np.float32), ()), scales)
    params, back = np.array([STRENGTH, DECAY], np.float32), np.array([-1.0], np.float32)
    state = np.zeros(1, np.float32)
    for _ in range(5):
        assert simulator.step(params, state, back) == pytest.approx(Belt().step(params, state, back))
        state = simulator.step(params, state, back)
    assert state[0] < -4
