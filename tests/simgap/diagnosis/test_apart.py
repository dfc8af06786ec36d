"""An unmeasured state that shares no axis with a measured one: the level of a tank that drains into another one."""

import numpy as np
import pytest
from tanks import SCHEMA, Tanks, recorded

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.inference.fitting.starts import fitted_starts
from simgap.diagnosis.likelihood.filter import gain_matrix
from simgap.diagnosis.likelihood.problem import Problem, evaluate, start
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.unmeasured import guessed
from simgap.effects.augmented import Augmented
from simgap.layout import Layout


def test_it_is_guessed_by_the_simulator_and_corrected_by_what_is_measured() -> None:
    layout = Layout(SCHEMA)
    assert layout.apart.tolist() == [False, True]
    assert layout.akin == ((1, 0),)
    (first, *_), *_ = guessed(Tanks(), recorded())
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


@pytest.mark.long
def test_where_nothing_is_missing_nothing_is_found() -> None:
    statement = diagnose(Tanks(), "tanks", recorded()).statement
    assert statement["found"] == []
    assert statement["verdict"] in ("nothing", "parameters_only", "inconclusive")


@pytest.mark.long
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
