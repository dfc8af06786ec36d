"""Cases of the training ground: the same by the same number, and what they are said to be."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from simgap.effects.augmented import Augmented
from simgap.ground import draw as ground
from simgap.ground.commands import drawn_commands
from simgap.ground.draw import draw
from simgap.ground.families import FAMILIES
from simgap.ground.family import ALL, READ, STAYING
from simgap.ground.laws import Push, Static, Uneven
from simgap.ground.machine import Integrated, Machine
from simgap.ground.machines import COUPLED, MACHINES, PAIR, PAIR_LEFT, SERVO
from simgap.ground.names import EQUIVALENT, names_of
from simgap.ground.readings import Curve, Offset, Old

NUMBERS = (2, 6, 10, 0, 7, 11, 1)
"""Of all kinds; the first four are brief, of the usual length (two), and long."""
ROWS = ground.USUAL[1]
case = cache(draw)
BY_NAME = {m.name: m for m in MACHINES}


def middle(machine: Machine) -> np.ndarray:
    """Parameters in the middle of their ranges."""
    return np.array([(p.low + p.high) / 2 for p in machine.parameters])


def commanded(machine: Machine, rng: np.random.Generator) -> np.ndarray:
    """Commands of a session."""
    return drawn_commands(len(machine.schema.command), rng, ground.WARM + ROWS)


def still(machine: Machine) -> np.ndarray:
    """Velocities that nothing shakes."""
    return np.zeros((ground.WARM + ROWS, len(machine.velocities)))


def test_a_case_is_drawn_from_its_number_alone() -> None:
    again = draw(case(2).number)
    assert again.families == case(2).families
    for a, b in zip(again.sessions.fitted, case(2).sessions.fitted, strict=True):
        np.testing.assert_array_equal(a.state, b.state)


@pytest.mark.long
def test_all_kinds_come_and_have_what_they_are_called() -> None:
    counts = {"nothing": {0}, "within": {1}, "two": {2}, "outside": {1}, "mixed": {2}, "many": {3, 4, 5}}
    named = {"nothing": {0}, "within": {1}, "two": {2}, "outside": {0}, "mixed": {1}, "many": set(range(6))}
    cases = [case(number) for number in NUMBERS]
    assert {c.kind for c in cases} >= {"nothing", "within", "two", "outside", "mixed", "many"}
    for c in cases:
        assert len(set(c.families)) == len(c.families)
        assert len(c.families) in counts[c.kind]
        assert sum(map(bool, c.causes)) in named[c.kind]
        assert (c.strength > 0) == bool(c.families)


@pytest.mark.parametrize("number", NUMBERS[:4])
def test_recordings_are_finite_and_of_the_machine(number: int) -> None:
    schema, sessions = case(number).machine.schema, case(number).sessions
    everything = (*sessions.fitted, *sessions.heldout)
    count, rows = len(everything), len(everything[0].time_s)
    assert (count, rows) == (ground.BRIEF, ground.USUAL, ground.USUAL, ground.LONG)[NUMBERS.index(number)]
    assert len(sessions.fitted) == {6: 4, 2: 1}[count]
    for r in everything:
        assert r.state.shape == (rows, len(schema.outputs))
        assert r.command.shape == (rows, len(schema.command))
        assert np.isfinite(r.state).all()


@pytest.mark.parametrize("machine", MACHINES, ids=lambda m: m.name)
def test_the_simulator_and_the_machine_differ_by_less_than_any_noise(machine: Machine) -> None:
    """Without laws and noise, a row of the simulator is a row of the machine."""
    rng = np.random.default_rng(0)
    params = np.array([(p.low + 2 * p.high) / 3 for p in machine.parameters])
    clean = ground._simulated(machine, params, [], commanded(machine, rng), still(machine))
    step = jax.vmap(lambda s, u: machine.step(jnp.asarray(params), s, u))
    predicted = np.asarray(step(clean.state[:-1], clean.command[:-1]))
    change = np.std(np.diff(clean.state, axis=0), 0)
    off = np.sqrt(np.mean((predicted - clean.state[1:]) ** 2, 0))
    assert (off < 0.1 * ground.NOISE[0] * change).all()


def test_shakes_change_the_velocities_and_are_none_of_the_laws() -> None:
    machine = MACHINES[0]
    command, shakes = commanded(machine, np.random.default_rng(1)), still(machine)
    shakes[-2] = 0.1
    calm, shaken = (ground._simulated(machine, middle(machine), [], command, s) for s in (0 * shakes, shakes))
    np.testing.assert_allclose(shaken.state[-1] - calm.state[-1], [0, 0.1], atol=1e-12)
    np.testing.assert_array_equal(shaken.state[:-1], calm.state[:-1])
    assert not shaken.changed.any()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_law_changes_what_the_machine_does_or_shows_and_more_with_its_size(name: str) -> None:
    machine = BY_NAME[FAMILIES[name].machines[0]]
    command = commanded(machine, np.random.default_rng(1))

    def change(size: float) -> float:
        law = FAMILIES[name].draw(np.random.default_rng(2), size, machine.time_step, 5.0)
        law.begin(np.random.default_rng(3))
        clean = ground._simulated(machine, middle(machine), [law], command, still(machine))
        changed, misread = np.abs(clean.changed).mean(), np.abs(clean.shown - clean.state).mean()
        assert changed < 1e-15 or misread < 1e-15
        return float(changed + misread)

    little, much = change(0.05), change(0.4)
    assert 0 < little < np.inf
    assert little == much if name == "rectified" else little < much < np.inf  # a sign is lost or is not


def test_an_uneven_law_acts_along_its_axes_and_more_in_some_places() -> None:
    plain = Static(lambda u: 0.5 * u)
    law = Uneven(plain, np.array([1.0, 0.0]), 0.5, 1.0, 0.0)
    up, down = (law.command(np.array([sign * np.pi / 2, 1.0]), 0.1) for sign in (1, -1))
    np.testing.assert_allclose(up, [0.25 * np.pi / 2, 1.0])
    np.testing.assert_allclose(down, [-0.75 * np.pi / 2, 1.0])
    pushed = Uneven(Push(lambda q, v, u: v + u + 1), np.array([0.0, 1.0]), 0.5, 1.0, 0.0)  # noqa: ARG005
    at = np.array([0.0, np.pi / 2, 0.0])
    np.testing.assert_allclose(pushed.push(at, np.zeros(2), np.zeros(2), 0.1), [0, 1.5])
    read = Uneven(Curve(lambda v: 2 * v), np.array([0.0, 1.0]), 0.5, 1.0, 0.0)
    np.testing.assert_allclose(read.read(np.array([3.0, np.pi / 2]), 0.1), [3, np.pi])


def test_a_reading_is_as_old_as_is_said_between_rows_too() -> None:
    old = Old(age=0.15, jitter=0.0)
    old.begin(np.random.default_rng(0))
    shown = [float(old.read(np.array([v]), 0.1)[0]) for v in (0.0, 1.0, 2.0, 4.0)]
    np.testing.assert_allclose(shown, [0, 0, 0.5, 1.5])


def test_an_offset_wanders_about_what_it_is() -> None:
    wide, fixed = Offset(0.2, 0.3, 1.0), Offset(0.2, 0.0, 1.0)
    for law in (wide, fixed):
        law.begin(np.random.default_rng(0))
    shown = np.array([wide.read(np.ones(1), 0.1) for _ in range(2000)])
    np.testing.assert_allclose(shown.mean(), 1.2, atol=0.02)
    np.testing.assert_allclose(shown.std(), 0.06, atol=0.02)
    np.testing.assert_allclose(fixed.read(np.ones(1), 0.1), 1.2)


def test_a_misread_speed_is_recorded_and_moves_nothing() -> None:
    scaled, old = (ground.recorded(5, PAIR, "within", (f,)) for f in ("sensor_scale", "old_reading"))
    assert min(scaled.strength, old.strength) > 0
    for one, other in zip(scaled.sessions.fitted, old.sessions.fitted, strict=True):
        np.testing.assert_array_equal(one.command, other.command)
        np.testing.assert_array_equal(one.state[:, PAIR.positions], other.state[:, PAIR.positions])
        assert (one.state != other.state).any()


def test_a_body_that_is_not_recorded_moves_as_if_it_were() -> None:
    command = commanded(PAIR, np.random.default_rng(1))
    both, left = (ground._simulated(m, middle(PAIR), [], command, still(m)).state for m in (PAIR, PAIR_LEFT))
    np.testing.assert_array_equal(both[:, [*PAIR.positions, *PAIR.velocities]],
                                  left[:, [*PAIR_LEFT.positions, *PAIR_LEFT.velocities]])  # fmt: skip
    for number in range(4):
        for r in ground.recorded(number, PAIR_LEFT, "within", ("friction",)).sessions.fitted:
            assert r.state.shape[1] == 2
            assert np.isfinite(r.state).all()


def test_a_friction_of_the_body_that_is_not_recorded_shows_in_the_other() -> None:
    rubs = Push(lambda q, v, u: np.array([0.0, -2.0]) * np.tanh(v / 0.01))  # noqa: ARG005
    command = commanded(PAIR_LEFT, np.random.default_rng(1))
    rubbed, free = (
        ground._simulated(PAIR_LEFT, middle(PAIR_LEFT), laws, command, still(PAIR_LEFT)) for laws in ([rubs], [])
    )
    assert np.std((rubbed.state - free.state)[:, 1]) > 0.1 * np.std(free.state[:, 1])
    assert rubbed.changed[:, :2].any()


@pytest.mark.parametrize("machine", MACHINES, ids=lambda m: m.name)
def test_no_law_is_drawn_where_a_machine_cannot_have_it(machine: Machine) -> None:
    rng = np.random.default_rng(0)
    drawn = {f for kind in ground.KINDS for _ in range(60) for f in ground._families(kind, machine, rng)}
    assert drawn == {name for name, family in FAMILIES.items() if machine.name in family.machines}


def test_no_machine_has_laws_that_a_parameter_imitates_or_that_nothing_recorded_shows() -> None:
    """A parameter of the drives scales the command alone; a sensor may be off whose speed is not recorded."""
    driven = {"cart", "pendulum", "pendulum_positions", "pair", "pair_left", "trolley", "links", "flyer", "hull"}
    assert not driven & set(FAMILIES["gain"].machines)
    read = {"cart", "servo", "pendulum", "pair", "base", "arm", *(m.name for m in COUPLED)}
    for family in ("sensor_scale", "old_reading", "lopsided", "rectified"):
        assert set(FAMILIES[family].machines) == {*read, "spot"}
    assert set(FAMILIES["sensor_bias"].machines) == read
    assert set(FAMILIES["leak"].machines) == {"pair", "pair_left", "base", "arm", "arm_positions", "wheels"}


def test_the_drift_of_a_response_is_within_the_vocabulary() -> None:
    """At the largest size, on rows of any length; in long sessions it fades for a part of the time only."""
    (bound,) = {abs(c.high) for e in Augmented(SERVO).catalogue if e.id == "gain_drift" for c in e.constants}
    for m, rows in ((m, rows) for m in MACHINES for _, rows in (ground.USUAL, ground.BRIEF, ground.LONG)):
        law = FAMILIES["fading"].draw(np.random.default_rng(rows), 0.5, m.time_step, 1.0)
        factor = [law.command(np.ones(1), m.time_step)[0] for _ in range(ground.WARM + rows)][ground.WARM :]
        slope = np.polyfit(m.time_step / 60 * np.arange(rows), np.array(factor) / factor[0], 1)[0]
        assert (0.1 if rows == ground.LONG[1] else 0.3) < abs(slope) < bound


def test_a_servo_that_is_commanded_too_much_is_one_whose_sensors_show_too_much() -> None:
    command = commanded(SERVO, np.random.default_rng(1))
    plain, more = (
        ground._simulated(SERVO, middle(SERVO), [Static(lambda u, g=g: g * u)], command, still(SERVO)).state
        for g in (1.0, 1.3)
    )
    np.testing.assert_allclose(more, 1.3 * plain, atol=1e-12)


@pytest.mark.parametrize("name", [m for m in STAYING if m in READ and BY_NAME[m] not in COUPLED])
def test_speeds_that_are_shown_too_small_are_rows_that_are_longer(name: str) -> None:
    """With other parameters: of those with 1/s the share that is shown, of the others its square."""
    machine, share, rng = BY_NAME[name], 0.8, np.random.default_rng(0)
    assert isinstance(machine, Integrated)
    others = middle(machine) * [share if p.name == "damping" else share**2 for p in machine.parameters]
    state, command = rng.standard_normal(len(machine.schema.state)), rng.standard_normal(len(machine.schema.command))
    shown = np.ones(len(state))
    shown[machine.velocities] = share
    slope = np.array(machine.derivative(np, middle(machine), state, command))
    longer = np.array(machine.derivative(np, others, shown * state, command)) / share
    np.testing.assert_allclose(longer, shown * slope)


@pytest.mark.parametrize("machine", MACHINES, ids=lambda m: m.name)
def test_every_name_is_an_effect_that_has_a_site_on_the_machine(machine: Machine) -> None:
    augmented = Augmented(machine)
    possible = {e.id for e, sites in zip(augmented.catalogue, augmented.sites, strict=True) if sites}
    for family in FAMILIES:
        if machine.name in FAMILIES[family].machines:
            assert names_of(family, machine.name) <= possible, family


def test_further_names_are_of_machines_and_families_that_there_are() -> None:
    assert {machine for machine, _ in EQUIVALENT} <= set(ALL)
    assert {family for _, family in EQUIVALENT} <= set(FAMILIES)
    assert all(machine in FAMILIES[family].machines for machine, family in EQUIVALENT)
