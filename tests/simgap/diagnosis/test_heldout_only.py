"""What held-out sessions alone show: commands large enough to meet a limit were sent in these only."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.exchange import exchanged
from simgap.ground.machines import CART
from simgap.types import Recording, Sessions

pytestmark = pytest.mark.long

ROWS, LIMIT = 200, 0.8


def session(name: str, largest: float, limit: float, rng: np.random.Generator) -> Recording:
    """The cart, driven to and fro with forces up to `largest`, of which those beyond `limit` are lost."""
    command = np.repeat(rng.uniform(-largest, largest, ROWS // 10), 10)[:, None]
    state = [np.zeros(2)]
    for u in command[:-1]:
        state.append(CART.row(np.array([5.0, 3.0]), state[-1], np.clip(u, -limit, limit), ()))
    clean = np.array(state)
    noise = 0.05 * np.std(np.diff(clean, axis=0), 0) * rng.standard_normal(clean.shape)
    return Recording(name, CART.time_step * np.arange(ROWS), clean + noise, command)


def recorded(limit: float, exchangeable: bool) -> Sessions:
    rng = np.random.default_rng(0)
    small = [session(f"small_{i}", LIMIT, limit, rng) for i in range(4)]
    large = [session(f"large_{i}", 1.25 * LIMIT, limit, rng) for i in range(2)]
    return Sessions(small, large, exchangeable=exchangeable)


@cache
def stated(limit: float, exchangeable: bool) -> dict[str, Any]:
    return diagnose(CART, "cart", recorded(limit, exchangeable)).statement


def test_sessions_that_show_something_are_fitted_and_others_held_out() -> None:
    statement = stated(LIMIT, True)
    assert [e["id"] for e in statement["effects"]] == ["saturation"]
    recordings = statement["recordings"]
    assert recordings["heldout_sessions"] == ["small_0", "small_3"]
    assert recordings["training_sessions"] == ["small_1", "small_2", "large_0", "large_1"]
    assert recordings["heldout_only"] is None
    (note,) = [n for n in statement["notes"] if n.startswith("At first large_0 and large_1 were held out.")]
    assert "small_0 and small_3 are held out instead" in note


def test_nothing_is_not_concluded_where_sessions_must_not_be_exchanged() -> None:
    statement = stated(LIMIT, False)
    assert statement["verdict"] == "inconclusive"
    assert not statement["effects"]
    assert statement["recordings"]["heldout_sessions"] == ["large_0", "large_1"]
    assert statement["recordings"]["heldout_only"] == {"effect": "saturation", "where": "cmd_slide"}
    assert "held-out sessions (large_0 and large_1) show what the fitted ones do not" in statement["statement"]
    assert statement["insufficient"][0]["remedy"].startswith("Give such sessions")


def test_sessions_stay_where_nothing_is_missing() -> None:
    statement = stated(np.inf, True)
    assert statement["recordings"]["heldout_only"] is None
    assert statement["recordings"]["heldout_sessions"] == ["large_0", "large_1"]
    assert statement["verdict"] in ("nothing", "parameters_only", "inconclusive")
    assert not statement["effects"]


@pytest.mark.parametrize(("training", "heldout"), [(1, 1), (2, 1), (3, 1), (6, 2), (5, 3)])
def test_an_exchange_keeps_all_sessions_and_as_many_held_out(training: int, heldout: int) -> None:
    names = [f"s{i}" for i in range(training + heldout)]
    every = [Recording(name, np.zeros(1), np.zeros((1, 2)), np.zeros((1, 1))) for name in names]
    after = exchanged(Sessions(every[:training], every[training:], exchangeable=True))
    assert sorted(r.name for r in (*after.training, *after.heldout)) == names
    assert len(after.heldout) == heldout
    assert {r.name for r in after.heldout} <= set(names[:training])
