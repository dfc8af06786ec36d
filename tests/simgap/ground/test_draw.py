"""Cases of the training ground: the same by the same number, and what they are said to be."""

from functools import cache

import jax
import numpy as np
import pytest

from simgap.effects.augmented import Augmented
from simgap.ground import draw as ground
from simgap.ground.draw import draw
from simgap.ground.families import EQUIVALENT, FAMILIES, names_of
from simgap.ground.laws import Push, Static, Uneven
from simgap.ground.machines import MACHINES, Machine

NUMBERS = range(16)
ROWS = ground.USUAL[1]
case = cache(draw)


def still(machine: Machine) -> np.ndarray:
    """Velocities that nothing shakes."""
    return np.zeros((ground.WARM + ROWS, machine.velocities))


def test_a_case_is_drawn_from_its_number_alone() -> None:
    again = draw(case(3).number)
    assert again.families == case(3).families
    for a, b in zip(again.sessions.fitted, case(3).sessions.fitted, strict=True):
        np.testing.assert_array_equal(a.state, b.state)


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
    assert (count, rows) in (ground.USUAL, ground.BRIEF)
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
    clean = ground._simulated(machine, params, [], ground._commands(machine, rng, ROWS), still(machine))
    predicted = np.asarray(jax.vmap(lambda s, u: machine.step(params, s, u))(clean.state[:-1], clean.command[:-1]))
    change = np.std(np.diff(clean.state, axis=0), 0)
    off = np.sqrt(np.mean((predicted - clean.state[1:]) ** 2, 0))
    assert (off < 0.1 * ground.NOISE[0] * change).all()


def test_shakes_change_the_velocities_and_are_none_of_the_laws() -> None:
    machine = MACHINES[0]
    params = np.array([(p.low + p.high) / 2 for p in machine.parameters])
    command, shakes = ground._commands(machine, np.random.default_rng(1), ROWS), still(machine)
    shakes[-2] = 0.1
    calm, shaken = (ground._simulated(machine, params, [], command, s) for s in (0 * shakes, shakes))
    np.testing.assert_allclose(shaken.state[-1] - calm.state[-1], [0, 0.1], atol=1e-12)
    np.testing.assert_array_equal(shaken.state[:-1], calm.state[:-1])
    assert not shaken.changed.any()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_law_changes_what_the_machine_does_and_more_with_its_size(name: str) -> None:
    machine = MACHINES[0]
    params = np.array([(p.low + p.high) / 2 for p in machine.parameters])
    command = ground._commands(machine, np.random.default_rng(1), ROWS)

    def change(size: float) -> float:
        law = FAMILIES[name].draw(np.random.default_rng(2), size, machine.time_step, 5.0)
        law.begin(np.random.default_rng(3))
        return float(np.abs(ground._simulated(machine, params, [law], command, still(machine)).changed).mean())

    assert 0 < change(0.05) < change(0.4)


def test_an_uneven_law_acts_along_its_axes_and_more_in_some_places() -> None:
    plain = Static(lambda u: 0.5 * u)
    law = Uneven(plain, np.array([1.0, 0.0]), 0.5, 1.0, 0.0)
    up, down = (law.command(np.array([sign * np.pi / 2, 1.0]), 0.1) for sign in (1, -1))
    np.testing.assert_allclose(up, [0.25 * np.pi / 2, 1.0])
    np.testing.assert_allclose(down, [-0.75 * np.pi / 2, 1.0])
    pushed = Uneven(Push(lambda q, v, u: v + u + 1), np.array([0.0, 1.0]), 0.5, 1.0, 0.0)  # noqa: ARG005
    at = np.array([0.0, np.pi / 2, 0.0])
    np.testing.assert_allclose(pushed.push(at, np.zeros(2), np.zeros(2), 0.1), [0, 1.5])


@pytest.mark.parametrize("machine", MACHINES, ids=lambda m: m.name)
def test_every_name_is_an_effect_that_has_a_site_on_the_machine(machine: Machine) -> None:
    augmented = Augmented(machine)
    possible = {e.id for e, sites in zip(augmented.catalogue, augmented.sites, strict=True) if sites}
    for family in FAMILIES:
        assert names_of(family, machine.name) <= possible, family


def test_further_names_are_of_machines_and_families_that_there_are() -> None:
    assert {machine for machine, _ in EQUIVALENT} <= {m.name for m in MACHINES}
    assert {family for _, family in EQUIVALENT} <= set(FAMILIES)
