"""Machines of the training ground whose axes move each other, and the laws that only they have."""

import jax.numpy as jnp
import numpy as np
import pytest

from simgap.ground import draw as ground
from simgap.ground.commands import drawn_commands
from simgap.ground.coupled import COUPLED, FLYER, GRAVITY, HULL, LINKS, POLE, TROLLEY, TWO_LINKS, Coupled
from simgap.ground.crossed import CROSSED, Sloshing, Waves
from simgap.ground.draw import DRAWN, draw
from simgap.ground.laws import Push, Static, Uneven
from simgap.ground.machine import Integrated

FIRST = next(number for number, machines in DRAWN.items() if machines == COUPLED)
JOINTED = (TROLLEY, TWO_LINKS)
ROWS = 200


def middle(machine: Integrated) -> np.ndarray:
    """Parameters in the middle of their ranges."""
    return np.array([(p.low + p.high) / 2 for p in machine.parameters])


def at_random(machine: Integrated, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A state and a command."""
    return rng.standard_normal(len(machine.schema.state)), rng.standard_normal(len(machine.schema.command))


def energy(machine: Coupled, params: np.ndarray, state: np.ndarray) -> float:
    """Of motion and of height [J]."""
    q, v = state[machine.positions], state[machine.velocities]
    motion = v @ machine.mass(np, params, q) @ v / 2
    if machine is TROLLEY:
        return float(motion - params[1] * GRAVITY * POLE * np.cos(q[1]))
    upper, lower, _ = params
    elbow = LINKS[0] * np.cos(q[0])
    return float(motion - GRAVITY * (upper * elbow / 2 + lower * (elbow + LINKS[1] / 2 * np.cos(q.sum()))))


@pytest.mark.parametrize("number", range(FIRST, FIRST + 5))
def test_cases_from_the_first_on_are_of_them(number: int) -> None:
    case = draw(number)
    assert any(case.machine is m for m in COUPLED)
    assert all(np.isfinite(r.state).all() for r in (*case.sessions.fitted, *case.sessions.heldout))


@pytest.mark.parametrize("machine", JOINTED, ids=lambda m: m.name)
def test_energy_changes_by_what_motors_and_damping_do(machine: Coupled) -> None:
    """The equations of motion are those of the energy: its rate is the power of what is not conservative."""
    rng, params = np.random.default_rng(0), middle(machine)
    for _ in range(5):
        state, command = at_random(machine, rng)
        slope = np.array(machine.derivative(np, params, state, command))
        h = 1e-5
        before, after = (energy(machine, params, state + sign * h * slope) for sign in (-1, 1))
        v = state[machine.velocities]
        damped = params[2] * v * ([1, 0] if machine is TROLLEY else [1, 1])
        power = command @ v[machine.driven] - damped @ v
        np.testing.assert_allclose((after - before) / (2 * h), power, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("machine", JOINTED, ids=lambda m: m.name)
def test_a_push_on_one_axis_moves_the_other_and_itself_as_if_it_were_a_force(machine: Coupled) -> None:
    rng, params = np.random.default_rng(1), middle(machine)
    state, command = at_random(machine, rng)
    q = state[machine.positions]
    inertia = machine.mass(np, params, q)[0, 0]
    pushed = machine.pushed(params, q, np.array([0.3, 0.0]))
    assert abs(pushed[1]) > 0.01
    stronger = command + np.eye(len(command))[0] * 0.3 * inertia
    by_force = np.array(machine.derivative(np, params, state, stronger))
    plain = np.array(machine.derivative(np, params, state, command))
    np.testing.assert_allclose(plain[machine.velocities] + pushed, by_force[machine.velocities])


@pytest.mark.parametrize("machine", COUPLED, ids=lambda m: m.name)
def test_a_law_of_commands_changes_only_axes_that_are_driven(machine: Integrated) -> None:
    rng, params = np.random.default_rng(2), middle(machine)
    state, command = at_random(machine, rng)
    axes = np.ones(len(machine.velocities))
    halved = Uneven(Static(lambda u: u / 2), axes, 0.0, 1.0, 0.0)
    np.testing.assert_allclose(
        machine.row(params, state, command, [halved]), machine.row(params, state, command / 2, [])
    )


@pytest.mark.parametrize("machine", COUPLED, ids=lambda m: m.name)
def test_laws_of_commands_are_drawn_along_driven_axes(machine: Integrated) -> None:
    for seed in range(20):
        law = ground._law(machine, "deadband", 0.1, 1.0, np.random.default_rng(seed))
        assert 0 < law.axes.sum() == law.axes[machine.driven].sum()


def test_a_flyer_stays_where_its_pilot_wants_it() -> None:
    command = drawn_commands(2, np.random.default_rng(3), 20 * ROWS)
    flown = ground._simulated(FLYER, middle(FLYER), [], command, np.zeros((20 * ROWS, 3)))
    assert np.abs(flown.state[:, :2]).max() < 5
    assert np.abs(flown.state[:, 2]).max() < np.pi / 2


def test_a_ship_goes_sideways_only_when_it_turns() -> None:
    params, ahead = middle(HULL), np.array([0, 0, 0, 1.0, 0, 0])
    straight, turning = (np.asarray(HULL.step(jnp.asarray(params), ahead, np.array([1.0, m]))) for m in (0.0, 1.0))
    assert straight[4] == 0
    assert turning[4] < 0


def test_waves_come_back_after_their_period() -> None:
    waves = Waves(0.3, 2 * np.pi / 0.5)
    waves.begin(np.random.default_rng(0))
    pushed = np.array([waves.push(None, np.zeros(2), None, 0.01) for _ in range(100)])
    np.testing.assert_allclose(pushed[:50], pushed[50:], atol=1e-12)
    np.testing.assert_allclose(pushed.max(), 0.3, rtol=0.01)


def test_a_load_that_sloshes_takes_momentum_and_gives_it_back() -> None:
    """A free body of mass 1 with a load of mass 0.5: together they keep their momentum."""
    load, v, h = Sloshing(0.5, 5.0, 0.1), np.array([1.0]), 1e-3
    assert not load.push(None, v, None, h).any()
    load.speed = np.array([0.0])
    for _ in range(2000):
        v = v + h * load.push(None, v, None, h)
        np.testing.assert_allclose(v + 0.5 * load.speed, 1.0, atol=1e-9)
    assert abs(v[0] - load.speed[0]) < 0.5


@pytest.mark.parametrize("name", ["crosswise", "shadow", "spilling"])
def test_an_axis_that_rests_is_pushed_by_what_another_does(name: str) -> None:
    law = CROSSED[name].draw(np.random.default_rng(0), 0.2, 0.05, 1.0)
    assert isinstance(law, Push)
    rest, q, u = np.zeros(2), np.array([0.0, 0.7]), np.array([0.0, 0.4])
    moving = law.push(q, np.array([0.0, 0.5]), u, 0.01) - law.push(0 * q, rest, 0 * u, 0.01)
    assert abs(moving[0]) > 1e-3


@pytest.mark.parametrize("name", ["skidding", "keel", "resistance"])
def test_a_drag_takes_energy(name: str) -> None:
    law = CROSSED[name].draw(np.random.default_rng(0), 0.2, 0.05, 1.0)
    v = np.array([0.4, -0.8])
    assert (law.push(np.zeros(2), v, np.zeros(2), 0.01) * v < 0).all()
