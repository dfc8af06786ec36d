"""The concealed robot: without an effect exactly the paper's; every effect nil at zero and at work beyond."""

from collections.abc import Sequence

import jax
import numpy as np
import pytest

from concealed.case import Recipe, conceal, features
from concealed.catalogue import FORMS, OUTSIDE, make
from concealed.form import Form, Size
from concealed.forms.measuring import Shaking
from concealed.operator import LIMIT, Habits, Person
from concealed.plain import Noise, Robot, advance, robot
from concealed.robot import Chance, Setting, Tape, run
from simgap.simulators.spot import Spot

SIZE = Size(sessions=3, copies=1, rows=80)
OF = Robot(
    np.array([[0.5, 0.4, 0.6, 0.1, 0.05, 0.3]]),
    np.linspace(-0.003, 0.003, 12)[None],
    np.array([[1.1, 1.2, 1.0, 0.95, 1.05, 1.15]]),
)
NOISE = Noise(np.full(12, 1e-3), np.full(12, 5e-3))


def play(forms: Sequence[Form], magnitudes: Sequence[Sequence[float]], noisy: bool, luck: int = 0) -> Tape:
    """Copies of three sessions, one a row of magnitudes."""
    size = SIZE._replace(copies=len(magnitudes))
    for form in forms:
        form.begin(size, np.random.default_rng(luck))
    first = np.zeros((size.batch, 12))
    first[:, 6], first[:, 8] = 0.75, 0.5
    rng = np.random.default_rng(3)
    draws = [size.tile(rng.normal(size=(3, size.rows, 12))) * noisy for _ in range(2)]
    person = Person(Habits(1.0, np.ones(6)), size, np.random.default_rng(1))
    many = robot(np.repeat(OF.flat, size.batch, axis=0))
    spread = np.repeat(np.array(magnitudes, float).reshape(len(magnitudes), len(forms)), SIZE.sessions, axis=0)
    setting = Setting(many, person, first, NOISE, Chance(*draws, 0 * draws[0]), size)
    return run(setting, forms, spread, None)


def test_the_plain_robot_is_the_papers_row_by_row() -> None:
    tape = play([], [[]], noisy=False)
    step = jax.jit(jax.vmap(Spot().step, (None, 0, 0)))
    for s in range(SIZE.sessions):
        x, u = tape.true[s], tape.command[s]
        next_of = np.asarray(step(OF.flat[0].astype(np.float32), x.astype(np.float32), u.astype(np.float32)))
        np.testing.assert_allclose(next_of[:-1], x[1:], atol=2e-5)
        np.testing.assert_allclose(advance(robot(np.repeat(OF.flat, len(x), 0)), x, u)[:-1], x[1:], atol=1e-12)


def test_without_noise_the_measured_state_is_the_true_one() -> None:
    tape = play([], [[]], noisy=False)
    difference = tape.measured - tape.true
    difference[..., 2] = np.angle(np.exp(1j * difference[..., 2]))
    assert np.abs(difference).max() < 1e-12
    assert np.abs(tape.command).max() <= LIMIT.max()


@pytest.mark.parametrize("name", [*FORMS, *OUTSIDE])
def test_an_effect_is_nil_at_zero_and_changes_what_is_measured_beyond(name: str) -> None:
    for seed in range(4):  # several sites and forms
        form = make(name, np.random.default_rng(seed))
        plain = play([], [[]], noisy=True)
        tape = play([form], [[0.0], [0.6 * form.scale], [0.6 * form.scale]], noisy=True, luck=seed)
        nil, much, again = (tape.measured[3 * k : 3 * k + 3] for k in range(3))
        np.testing.assert_allclose(nil, plain.measured, atol=1e-9)
        np.testing.assert_array_equal(much, again)  # copies meet the same chance
        assert np.isfinite(much).all()
        # A wall or a floor may be out of reach of a few seconds; nothing else may.
        assert name in ("reach_limit", "ground_contact") or np.abs(much - nil).max() > 1e-3, name


@pytest.mark.parametrize("name", ["coulomb_friction", "viscous_drag", "quadratic_drag"])
def test_resistance_only_slows(name: str) -> None:
    """Of base and arm by themselves, pushed alike: never faster with resistance than without."""
    form = make(name, np.random.default_rng(0))
    form.m = np.array([0.1])
    form.begin(Size(1, 1, 4), np.random.default_rng(0))

    class Still:
        t = 0

    for speed in (-0.6, -0.1, 0.05, 0.5):
        v = np.full((1, 3), speed)
        driven = form.drive(Still(), 0, form.part, v.copy(), v)  # pyright: ignore
        assert (np.abs(driven) <= np.abs(v) + 1e-12).all()


def test_noise_that_grows_with_motion_leaves_the_true_motion_alone() -> None:
    form = Shaking(np.random.default_rng(0))
    assert (form.growth_at(np.zeros((1, 12)), 2.0) == 1).all()
    moving = np.zeros((1, 12))
    moving[:, 3] = moving[:, 9] = 1.0
    assert (form.growth_at(moving, 2.0) > 2).all()


def test_a_case_is_the_same_again_and_its_key_tells_the_truth() -> None:
    recipe = Recipe("regime", ("gain",), 30.0, "few", 1.0, False, False, False, False, False)
    one, two = conceal(recipe, 5), conceal(recipe, 5)
    np.testing.assert_array_equal(one.measured, two.measured)
    assert one.key == two.key
    assert conceal(recipe, 6).key != one.key
    (effect,) = one.key["effects"]
    assert (effect["id"], effect["accept"][0]) == ("gain", "gain")
    assert effect["constants"][0]["value"] == pytest.approx(1 - effect["magnitude"])
    name, edge = one.key["when"]["regime"].split(" > ")
    inside = features(one.measured, one.command)[name] > float(edge.split()[0])
    assert inside.mean() == pytest.approx(one.key["gated_share"], abs=0.1)


def test_a_late_onset_leaves_the_rows_before_alone() -> None:
    recipe = Recipe("onset", ("gain",), 300.0, "few", 1.0, False, False, False, False, False)
    case, plain = conceal(recipe, 9), conceal(recipe._replace(names=(), kind="null", target=0.0), 9)
    row = round(case.key["when"]["from_s"] * 15)
    np.testing.assert_array_equal(case.measured[:, :row], plain.measured[:, :row])
    assert not np.array_equal(case.measured[:, row + 2 :], plain.measured[:, row + 2 :])


def test_every_kind_of_null_is_explained_by_the_plain_robot() -> None:
    """Wild parameters included, what the true plain robot leaves of a null is noise of unit variance."""
    from concealed.case import noise_of
    from concealed.plain import innovations, observer, whitened

    for wild, poor in ((False, False), (True, True)):
        case = conceal(Recipe("null", (), 0.0, "usual", 1.0, poor, False, wild, False, False), 3)
        of = robot(np.array(case.key["parameters"])[None])
        by = observer(of, noise_of(1.0))
        e = innovations(robot(np.repeat(of.flat, len(case.measured), 0)), by, case.measured, case.command)
        white = whitened(by, e)[:, 20:]
        assert white.var(axis=(0, 1)) == pytest.approx(1.0, abs=0.2)
