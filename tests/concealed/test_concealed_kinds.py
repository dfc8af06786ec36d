"""Machines of five kinds: without a cause each is what its user's simulator says, and each cause changes it."""

from typing import Any

import jax
import numpy as np
import pytest

from concealed.kinds.case import Recipe, conceal
from concealed.kinds.causes import CAUSES
from concealed.kinds.robots import KINDS, Kind
from concealed.kinds.session import PLAIN, Recorded, Traits, chance, record, row
from concealed.kinds.strength import strength
from concealed.kinds.suite import recipes
from examples import kinds as known
from simgap.effects import CATALOGUE

kinds = pytest.mark.parametrize("kind", KINDS)


def simulator_of(kind: str) -> Any:
    """What its user has."""
    return getattr(known, KINDS[kind].simulator.removeprefix("examples.kinds:"))


def drawn(kind: str) -> tuple[Kind, np.ndarray]:
    """A kind of machine and parameters of one."""
    of = KINDS[kind]
    return of, np.random.default_rng(0).uniform(of.low, of.high)


def recorded(kind: str, traits: Traits = PLAIN, sessions: int = 4, rows: int = 60) -> Recorded:
    of, p = drawn(kind)
    return record(of, p, traits, chance(of, sessions, rows, np.random.default_rng(1)), 1.0)


@kinds
def test_the_users_simulator_has_the_columns_and_ranges_of_the_machine(kind: str) -> None:
    of, simulator = KINDS[kind], simulator_of(kind)
    assert tuple(f.name for f in simulator.schema.state) == of.columns.state
    assert tuple(f.name for f in simulator.schema.command) == of.columns.command
    assert simulator.time_step == of.interval
    assert [f.kind == "angle" for f in simulator.schema.state] == of.turns.tolist()
    assert all(
        q.low <= low < high <= q.high for q, low, high in zip(simulator.parameters, of.low, of.high, strict=True)
    )


@kinds
def test_without_a_cause_a_machine_does_what_its_simulator_says(kind: str) -> None:
    """To a tenth of the noise with which it is measured."""
    (of, p), simulator = drawn(kind), simulator_of(kind)
    measured, command = recorded(kind)
    x, u = measured.reshape(-1, measured.shape[2]), command.reshape(-1, command.shape[2])
    after, _ = row(of, p, x, PLAIN, u[None], u)
    said = jax.vmap(lambda x, u: simulator.step(np.float32(p), x, u))(np.float32(x), np.float32(u))
    assert np.abs((after - np.asarray(said)) / of.measured).max() < 0.1


@pytest.mark.parametrize("cause", CAUSES)
def test_a_cause_shows_and_is_named_by_words_that_there_are(cause: str) -> None:
    recipe = Recipe(CAUSES[cause].kind, cause)
    case, without = conceal(recipe, 1, 50, 3), conceal(recipe._replace(cause=None), 1, 50, 3)
    assert np.isfinite(case.measured).all()
    assert not np.allclose(case.measured, without.measured, atol=1e-6)
    assert np.isfinite(case.key["strength"])
    assert set(CAUSES[cause].accept) <= {effect.id for effect in CATALOGUE}
    assert case.key["kind"] == ("single" if CAUSES[cause].accept else "outside")


def test_equal_seeds_give_equal_cases_and_others_others() -> None:
    recipe = Recipe("boat", "keel")
    first, again, other = (conceal(recipe, 1, 20, seed) for seed in (3, 3, 4))
    assert np.array_equal(first.measured, again.measured)
    assert first.key == again.key
    assert not np.allclose(first.measured, other.measured)


@kinds
def test_strength_is_what_the_truth_gains(kind: str) -> None:
    """Nothing, where it is the simulator itself; less than that, where it is not the truth; much for late commands."""
    of, p = drawn(kind)
    late = Traits(late=3 * of.interval)
    assert strength(of, p, PLAIN, recorded(kind), 1.0) == 0.0
    assert strength(of, p, late, recorded(kind), 1.0) < -3
    assert strength(of, p, late, recorded(kind, late), 1.0) > 3


def test_every_part_has_some_of_each_kind() -> None:
    dealt = recipes(4, 2, 2, np.random.default_rng(0))
    assert sum(len(part) for part in dealt) == 4 * len(KINDS) + 2 * len(CAUSES)
    for part in dealt:
        assert {recipe.kind for recipe in part if recipe.cause is None} == set(KINDS)
        assert {recipe.cause for recipe in part} == {None, *CAUSES}
