"""Laws that are not exact: their misfit is credited to no further effect, and what is more than misfit is found."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planted import SPOT

from simgap.diagnosis.hypotheses.place import place_of
from simgap.diagnosis.inference.explain import explain
from simgap.diagnosis.inference.misfit.relaxation import softly
from simgap.effects.sites import channel_sites
from simgap.ground.draw import recorded
from simgap.ground.machines import CART, PAIR, Machine


@given(st.integers(0, 10_000), st.integers(1, 12), st.floats(0.01, 10.0))
def test_taking_out_twice_leaves_what_the_prior_leaves(seed: int, count: int, size: float) -> None:
    """(1 - T T')^2 is 1 - C' (1 + C C')^-1 C, for columns C that are clear of the basis."""
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.standard_normal((40, 3)))[0].astype(np.float32)
    columns = (size * rng.standard_normal((count, 40))).astype(np.float32)
    taken = softly(columns, basis)
    clear = columns - (columns @ basis) @ basis.T
    left = np.eye(40) - clear.T @ np.linalg.solve(np.eye(count) + clear @ clear.T, clear)
    np.testing.assert_allclose(np.linalg.matrix_power(np.eye(40) - taken @ taken.T, 2), left, atol=2e-3)
    np.testing.assert_allclose(taken.T @ basis, 0, atol=1e-3)


def test_without_columns_nothing_is_taken_out() -> None:
    assert softly(np.zeros((0, 7), np.float32), np.zeros((7, 2), np.float32)).shape == (7, 0)


def test_a_channel_is_at_the_axis_that_it_drives() -> None:
    layout = SPOT.layout
    for site in channel_sites(layout):
        place = place_of(layout, site)
        ((body, axis),) = place.moving
        assert layout.schema.command[layout.driven[body, axis]].name == site.name == place.channels[0]


@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "machine", "families", "named"),
    [(6, CART, ("lag",), {"lag"}), (1, PAIR, ("delay", "rate_limit"), {"delay", "rate_limit"})],
    ids=["a lag of two poles", "an uncertain delay, and a rounded limit"],
)
def test_what_a_law_is_wrong_by_has_no_name(
    number: int, machine: Machine, families: tuple[str, ...], named: set[str]
) -> None:
    case = recorded(number, machine, "within", families)
    found = explain(case.machine, case.sessions, np.random.default_rng(0), print)
    assert {m.hypothesis.effect.id for m in found.members} == named
    assert all(m.misfit > 0 for m in found.members)


@pytest.mark.long
def test_where_the_law_is_nearly_exact_bending_it_gains_next_to_nothing() -> None:
    case = recorded(1, PAIR, "within", ("play",))
    found = explain(case.machine, case.sessions, np.random.default_rng(0), print)
    (play,) = found.members
    assert play.hypothesis.effect.id == "backlash"
    assert play.misfit < 0.05 * play.gain
