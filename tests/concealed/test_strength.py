"""Strength in nats means what it says: what the true form gains."""

from collections.abc import Callable

import numpy as np
import pytest

from concealed import case as cases
from concealed import plain
from concealed.case import Recipe, conceal, noise_of
from concealed.catalogue import FORMS, OUTSIDE
from concealed.plain import TIME_STEP
from concealed.strength import HELD_OUT, Found, reach_for


def test_the_strength_is_what_the_true_form_gains_on_noisy_recordings() -> None:
    """Of gravity's sag the true form is written in a line: its likelihood against the best plain robot's, both with
    innovations of a covariance of their own, over all rows."""
    gains, strengths = [], []
    for seed in range(3):
        recipe = Recipe("single", ("gravity_sag",), 60.0, "usual", 1.0, False, False, False, False, False)
        case = conceal(recipe, seed)
        of, sessions = plain.robot(np.array(case.key["parameters"])[None]), len(case.measured)
        filters = plain.observers(of, noise_of(1.0))
        many = plain.robot(np.repeat(of.flat, sessions, axis=0))
        sink = case.key["effects"][0]["magnitude"]
        by = plain.Observer(*(a[0] for a in filters))
        x, e = case.measured[:, 0].copy(), []
        for t in range(case.measured.shape[1] - 1):
            reach = np.hypot(x[:, 6] - x[:, 0], x[:, 7] - x[:, 1])
            x = plain.advance(many, x, case.command[:, t])
            sunk = (1 - of.alpha[0, 5]) * sink * reach
            x[:, 11] -= sunk
            x[:, 8] -= TIME_STEP * of.gamma[0, 5] * sunk
            e.append(plain.wrapped(case.measured[:, t + 1] - x))
            plain.correct(by, x, e[-1])
        true = spread(np.stack(e, axis=1)[None])[0]
        groups = len(filters.gain)
        copies = [np.repeat(a[None], groups, axis=0) for a in (case.measured, case.command)]
        _, left = plain.refit(of, filters, *copies)
        rows = case.measured.shape[0] * (case.measured.shape[1] - 1)
        gains.append(0.5 * rows * (spread(left).min(0) - true).sum())
        strengths.append(case.key["strength"])
    # The plain robot is fitted to the very rows, 24 numbers: it gains a dozen nats of noise by that.
    assert HELD_OUT * np.mean(gains) == pytest.approx(np.mean(strengths), rel=0.15)


def spread(e: np.ndarray) -> np.ndarray:
    """Log determinant of every axis' innovation covariance [G, 6]."""
    pairs = np.stack([e[..., plain.POSITION], e[..., plain.VELOCITY]], axis=-1)
    return np.linalg.slogdet(np.einsum("gstai,gstaj->gaij", pairs, pairs) / pairs.shape[1] / pairs.shape[2])[1]


@pytest.mark.parametrize(("name", "seed"), [("gain", 0), ("coulomb_friction", 1), ("delay", 2), ("slope", 3)])
def test_a_case_has_the_strength_that_was_wanted(name: str, seed: int) -> None:
    for target in (10.0, 100.0):
        case = conceal(Recipe("single", (name,), target, "few", 1.0, False, False, False, False, False), seed)
        assert case.key["strength"] == pytest.approx(target, rel=0.35)


FRICTION = [("coulomb_friction", seed, level) for seed in (0, 2, 4, 5) for level in (0.5, 2.0)]
"""On axes along which the base's turning, or another axis, pulls."""


@pytest.mark.parametrize(("name", "seed", "level"), [*((name, 1, 0.5) for name in (*FORMS, *OUTSIDE)), *FRICTION])
def test_an_effect_of_next_to_nothing_has_no_strength(
    name: str, seed: int, level: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def vanish(_: float, evaluate: Callable[[float], float]) -> Found:
        some, less = evaluate(1e-3), evaluate(1e-5)
        assert some < 2.5
        assert less < max(1e-3 * some, 1e-9)  # with the square of the magnitude, but for thresholds
        return Found(1e-5, less)

    monkeypatch.setattr(cases, "reach_for", vanish)
    case = conceal(Recipe("single", (name,), 50.0, "few", level, False, False, False, False, False), seed)
    assert case.key["strength"] < 1e-3


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_a_weak_friction_is_one_that_can_be_seen(seed: int) -> None:
    """Not one of next to nothing that has a strength all the same."""
    case = conceal(Recipe("single", ("coulomb_friction",), 8.0, "few", 0.5, False, False, False, False, False), seed)
    assert case.key["strength"] == pytest.approx(8.0, rel=0.35)
    assert case.key["effects"][0]["magnitude"] > 1e-3


def test_the_search_finds_thresholds_and_says_what_is_out_of_reach() -> None:
    squares = reach_for(50.0, lambda f: 1e4 * f**2)
    assert squares.nats == pytest.approx(50.0, rel=0.25)
    wall = reach_for(50.0, lambda f: 4e3 * max(f - 0.4, 0.0) ** 1.5)
    assert wall.nats == pytest.approx(50.0, rel=0.5)
    weak = reach_for(50.0, lambda f: 2.0 * f)
    assert (weak.factor, weak.nats) == (1.0, 2.0)
