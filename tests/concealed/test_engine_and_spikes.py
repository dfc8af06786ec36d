"""Causes in the physics engine and spikes in recordings do what their keys say."""

import numpy as np
import pytest

from concealed import engine, spikes
from concealed.case import Recipe, conceal
from concealed.engine import CAUSES, Machine, Set, changed, record
from concealed.plain import TIME_STEP


@pytest.fixture(scope="module")
def usual() -> Set:
    """A machine as it is, teleoperated."""
    return record(Machine(), np.random.default_rng(0))


def lag_of(recorded: Set, command: int, output: int) -> float:
    """Rows by which a velocity follows its command, at the peak of their correlation."""
    u, v = recorded.command[..., command], recorded.measured[..., output]
    return float(np.argmax([np.corrcoef(u[:, 8:-8].ravel(), v[:, 8 + k : (k - 8) or None].ravel())[0, 1]
                            for k in range(8)]))  # fmt: skip


def test_the_machine_follows_its_commands(usual: Set) -> None:
    """Yaw rate and the hand's height, which no turn of the body frame mixes."""
    for command, output in ((2, 5), (5, 11)):
        u, v = usual.command[:, :-1, command].ravel(), usual.measured[:, 1:, output].ravel()
        assert np.corrcoef(u, v)[0, 1] > 0.9
    assert np.isfinite(usual.measured).all()
    moved = np.diff(usual.measured[:, :, [0, 1, 6, 7, 8]], axis=1) / TIME_STEP
    mean = 0.5 * (usual.measured[:, 1:] + usual.measured[:, :-1])[..., [3, 4, 9, 10, 11]]
    assert np.corrcoef(moved.ravel(), mean.ravel())[0, 1] > 0.95  # positions are what velocities add up to


def test_every_cause_changes_the_machine_and_nothing_else_does() -> None:
    assert changed(None, False) == Machine()
    for cause in CAUSES:
        small, large = changed(cause, False), changed(cause, True)
        assert len({Machine(), small, large}) == 3


@pytest.mark.long
def test_causes_have_their_effects_in_the_engine(usual: Set) -> None:
    of = lambda cause: record(changed(cause, True), np.random.default_rng(0))  # noqa: E731
    sag = lambda s: (s.measured[:, 1:, 11] - s.command[:, :-1, 5]).mean()  # noqa: E731
    assert sag(of("payload on the hand")) < sag(usual) - 0.01
    late = of("late commands")
    assert lag_of(late, 2, 5) >= lag_of(usual, 2, 5) + 1.5
    speed = lambda s: np.hypot(s.measured[..., 3], s.measured[..., 4]).mean()  # noqa: E731
    assert speed(of("slippery floor")) < speed(usual)
    tilted = of("tilted floor")
    assert (tilted.measured[..., 3]).mean() > usual.measured[..., 3].mean() + 0.02


@pytest.mark.long
def test_a_case_of_the_engine_has_a_key_with_reasons() -> None:
    case = engine.conceal("joint friction", True, np.random.default_rng(0))
    (effect,) = case.key["effects"]
    assert "coulomb_friction" in effect["accept"]
    assert effect["why"]
    assert case.key["strength"] > 3
    assert case.before.measured.shape == case.after.measured.shape == (8, 321, 12)


def sessions() -> list[spikes.Pair]:
    """Sessions of the plain robot."""
    case = conceal(Recipe("null", (), 0.0, "few", 1.0, False, False, False, False, False), 1)
    return list(zip(case.measured, case.command, strict=True))


def test_spikes_are_what_the_key_says() -> None:
    pairs = sessions()
    x, u = pairs[0]
    late, sent = spikes.SPIKES["base commands late by two rows"].apply(x, u)
    np.testing.assert_array_equal(sent[:-2, :3], u[2:-2, :3])
    np.testing.assert_array_equal(sent[:, 3:], u[:-2, 3:])
    np.testing.assert_array_equal(late, x[:-2])
    _, sent = spikes.SPIKES["walks with 0.7 of the command"].apply(x, u)
    np.testing.assert_allclose(0.7 * sent[:, 0], u[:, 0])
    down, _ = spikes.SPIKES["the arm sinks"].apply(x, u)
    sunk = np.diff(x[:, 8] - down[:, 8]) / TIME_STEP
    np.testing.assert_allclose(sunk, (x - down)[1:, 11], atol=1e-9)
    for name, spike in spikes.SPIKES.items():
        after, key = spikes.conceal(name, pairs, [(x.copy(), u.copy()) for x, u in pairs])
        assert {len(x) for x, _ in after} == {len(x) - spikes.LATEST}  # the length does not tell
        assert key["kind"] == "real"
        assert key["effects"][0]["accept"] == list(spike.accept)
        assert key["strength"] > 1, name
    assert spikes.conceal(None, pairs, pairs)[1]["strength"] == 0.0
