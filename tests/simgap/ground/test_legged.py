"""The legged base with an arm of the training ground, and the laws that only it has."""

import numpy as np
import pytest

from simgap.ground import draw as ground
from simgap.ground.commands import drawn_commands
from simgap.ground.draw import DRAWN, draw
from simgap.ground.laws import Push, Static
from simgap.ground.legged import LEGGED
from simgap.ground.spot import FINER, HOME, SPOT, USUAL

FIRST = next(number for number, machines in DRAWN.items() if machines == (SPOT,))
ROWS = 120
STILL = np.zeros((ground.WARM + ROWS, 6))
PARAMS = SPOT.drawn(np.random.default_rng(3))
PARAMS[1] = PARAMS[0]  # the model's memory is along the world's axes
COMMANDS = drawn_commands(6, np.random.default_rng(1), ground.WARM + ROWS)


def simulated(law: Push | Static | None = None) -> ground._Clean:
    """A session, with a law or without."""
    return ground._simulated(SPOT, PARAMS, [law] if law else [], COMMANDS, STILL)


def from_home(state: np.ndarray) -> np.ndarray:
    """The hand's horizontal distance from home, which turns with the base."""
    c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
    return np.hypot(*(state[:, 6:8] - state[:, :2] - np.stack([c, s], 1) * HOME[0]).T)


@pytest.mark.long
@pytest.mark.parametrize("number", range(FIRST, FIRST + 5))
def test_cases_from_the_first_on_are_of_it(number: int) -> None:
    case = draw(number)
    assert case.machine is SPOT
    assert all(np.isfinite(r.state).all() for r in (*case.sessions.fitted, *case.sessions.heldout))


def test_the_case_before_is_not() -> None:
    assert draw(FIRST - 1).machine is not SPOT


def test_a_command_that_is_followed_too_far_is_a_larger_command() -> None:
    clean = simulated(Static(lambda u: 1.2 * u))
    for before, after, sent in zip(clean.state[:-1], clean.state[1:], clean.command[:-1], strict=True):
        np.testing.assert_allclose(after, SPOT.row(PARAMS, before, 1.2 * sent, ()), atol=1e-12)


def test_a_push_of_an_axis_changes_this_velocity_in_its_own_frame() -> None:
    """In a row a push adds what the model's memory leaves of it. The hand's velocity in the world has the base's."""
    push = 0.1 * np.eye(6)[1]
    changed = simulated(Push(lambda q, v, u: push)).changed  # noqa: ARG005
    left = PARAMS[1] ** (np.arange(FINER) / FINER)
    added = 0.1 * USUAL[1] * SPOT.time_step * left.mean()
    np.testing.assert_allclose(np.hypot(changed[:, 3], changed[:, 4]), added)
    np.testing.assert_allclose(changed[:, 5], 0, atol=1e-12)
    np.testing.assert_allclose(changed[:, 9:11], changed[:, 3:5], atol=1e-12)


def test_the_hand_stays_near_home_and_the_commands_that_keep_it_there_are_recorded() -> None:
    clean = simulated()
    assert from_home(clean.state).max() < 1.5
    drawn = USUAL * COMMANDS[ground.WARM :]
    np.testing.assert_array_equal(clean.command[:, :3], drawn[:, :3])
    assert (clean.command[:, 3:] != drawn[:, 3:]).any()


@pytest.mark.parametrize("family", LEGGED)
def test_a_law_of_its_own_acts_along_the_axes_that_it_is_said_to(family: str) -> None:
    """Also where others draw a single axis."""
    kind, rng = LEGGED[family], np.random.default_rng(0)
    q, v, u = np.array([0.3, 0.2, 0.5, 0.4, 0.2, -0.5]), rng.uniform(0.3, 1, 6), np.ones(6)
    for _ in range(8):
        law = ground._law(SPOT, family, 0.05, 20.0, rng)
        law.begin(rng)
        assert set(np.flatnonzero(law.push(q, v, u, 0.01))) <= set(kind.axes)
        assert law.push(q, v, u, 0.01).any()
