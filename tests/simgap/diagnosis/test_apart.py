"""An unmeasured state that shares no axis with a measured one: the level of a tank that drains into another one."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.inference.starts import fitted_starts
from simgap.diagnosis.likelihood.filter import gain_matrix
from simgap.diagnosis.likelihood.problem import Problem, evaluate, start
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.unmeasured import guessed
from simgap.effects.augmented import Augmented
from simgap.layout import Layout
from simgap.types import Field, Parameter, Recording, Schema, Sessions

ROWS, FINER, NOISE = 300, 40, 0.02
UPPER, LOWER, PUMP = 0.05, 0.052, 0.055
SCHEMA = Schema(
    (
        Field("lower", "V", "position", "world", "lower"),
        Field("upper", "V", "position", "world", "upper", observed=False),
    ),
    (Field("pump", "V", "force", "world", "upper"),),
)


@dataclass(frozen=True)
class Tanks:
    """Levels [V] of two tanks: a pump fills the upper one, which drains into the lower one."""

    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = tuple(Parameter(n, "-", 0.02, 0.12, nominal=0.05) for n in ("a", "b", "c"))
    time_step: float = 4.0

    def step(self, params: Float[Array, " 3"], state: Float[Array, " 2"], command: Float[Array, " 1"]) -> Array:
        """Four steps of the midpoint rule."""

        def rates(levels: Array) -> Array:
            upper, lower, pump = params
            out = jnp.sqrt(jnp.maximum(levels, 1e-3)) * jnp.stack([lower, upper])
            return jnp.stack([out[1] - out[0], pump * command[0] - out[1]])

        h = self.time_step / 4
        for _ in range(4):
            state = state + h * rates(state + h / 2 * rates(state))
        return state


def session(rng: np.random.Generator, upper_full: float = np.inf, lower_full: float = np.inf) -> Recording:
    """Both tanks, which may overflow, in steps far finer than a row."""
    lower, upper, seen = 3.0, 3.0, []
    command = np.repeat(rng.uniform(0, 8.5, ROWS // 20), 20)
    for u in command:
        seen.append((lower, upper))
        for _ in range(FINER):
            h = Tanks().time_step / FINER
            through, out = UPPER * np.sqrt(upper), LOWER * np.sqrt(lower)
            upper = float(np.clip(upper + h * (PUMP * u - through), 0.0, upper_full))
            lower = float(np.clip(lower + h * (through - out), 0.0, lower_full))
    time_s, state = Tanks().time_step * np.arange(ROWS), np.array(seen)
    measured = state[:, :1] + NOISE * rng.standard_normal((ROWS, 1))
    return Recording(f"session_{rng.integers(10**6)}", time_s, measured, command[:, None])


def recorded(**full: float) -> Sessions:
    rng = np.random.default_rng(0)
    recordings = [session(rng, **full) for _ in range(4)]
    return Sessions(recordings[:3], recordings[3:])


def test_it_is_guessed_by_the_simulator_and_corrected_by_what_is_measured() -> None:
    layout = Layout(SCHEMA)
    assert layout.apart.tolist() == [False, True]
    assert layout.akin == ((1, 0),)
    (first, *_), _, _ = guessed(Tanks(), recorded())
    # Twenty rows later the level of a leaking tank depends little on where it began.
    flows = np.sqrt(first.state[20:, 1])
    assert np.corrcoef(flows, np.sqrt(np.maximum(first.state[20:, 0], 0)))[0, 1] > 0.5


def test_its_gain_is_in_units_of_its_usual_size() -> None:
    """A level that varies ten times as much as what is measured is corrected by as much."""
    sessions, augmented = guessed(Tanks(), recorded()), Augmented(Tanks())
    scales = measure(augmented, sessions.fitted)
    v = start(Problem(augmented, scales, cut(sessions.fitted, Tanks().time_step), np.eye(1)))
    K = np.asarray(gain_matrix(augmented, scales, v._replace(cross=np.ones(1, np.float32))))
    assert K[1, 0] == pytest.approx(scales.output[1] / scales.output[0], rel=1e-5)
    assert K[0, 1] == 0


def test_where_nothing_is_missing_nothing_is_found() -> None:
    statement = diagnose(Tanks(), "tanks", recorded()).statement
    assert statement["found"] == []
    assert statement["verdict"] in ("nothing", "parameters_only", "inconclusive")


@pytest.mark.parametrize(("tank", "width"), [("upper", 4.0), ("lower", 0.1)])
def test_an_overflow_is_named_with_its_level(tank: str, width: float) -> None:
    """Of the upper tank, whose level is not measured, as well: below, it looks as if the pump gave no more."""
    statement = diagnose(Tanks(), "tanks", recorded(**{f"{tank}_full": 10.0})).statement
    (named,) = statement["effects"]
    assert (named["id"], named["form"], named["where"]) == ("output_limit", "quantity", tank)
    (limit,) = named["constants"]
    low, high = limit["ci95"]
    assert low < 10.0 < high
    assert high - low < width


def test_a_start_on_which_hardly_anything_measured_depends_stays_near_its_guess() -> None:
    """A hole that is almost closed: what the lower tank does is then no reason to change the upper one's level."""
    sessions = guessed(Tanks(), recorded())
    augmented = Augmented(Tanks())
    chunks = cut(sessions.fitted, Tanks().time_step)
    problem = Problem(augmented, measure(augmented, sessions.fitted), chunks, np.eye(1))
    v = start(problem)._replace(phi=np.array([1e-6, 0.05, 0.05], np.float32))
    fitted, _ = fitted_starts(problem, evaluate(problem, v, ()), free=False)
    first = chunks.row == 0  # of a session: others begin where the one before ends
    moved = (np.asarray(fitted.chunks.state) - np.asarray(chunks.state))[first, 0]
    np.testing.assert_array_equal(moved[:, 0], 0)
    assert np.abs(moved[:, 1]).max() < 2 * problem.scales.output[1]
