"""Planted effects are named, with their constants; where nothing is planted nothing is claimed."""

import numpy as np
import pytest
from planted import PHI, SCALES, SPOT, theta
from small import KEYS, RICH, acting, assert_explains, explain, problem, sessions

from simgap.diagnosis.config import LEVEL
from simgap.diagnosis.hypotheses.features import inside
from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.hypotheses.support import From, Window
from simgap.diagnosis.inference.evidence.screening import Screened
from simgap.diagnosis.inference.fitting.heldout import agrees
from simgap.diagnosis.inference.search import posterior
from simgap.diagnosis.inference.search.one_more import promising
from simgap.diagnosis.likelihood.problem import value_of
from simgap.diagnosis.likelihood.segments import rows_of
from simgap.effects import CATALOGUE
from simgap.effects.regime import Regime, features

SMOOTH_ARM = np.r_[PHI[:3], 0.3, 0.3, 0.3, PHI[6:]].astype(np.float32)
"""A hand that remembers its velocity, without which it does not matter what it remembers."""


def case(key: str, constants: tuple[float, ...], sites: tuple[int, ...] = (0,), **more):
    return pytest.param(key, constants, sites, more, id=f"{key}-{'-'.join(map(str, sites))}")


BASE, ARM = (0, 1, 2), (3, 4, 5)
CASES = [
    case("delay", (1.4,), BASE),
    case("lag", (1.4,), ARM),
    case("resonance", (1.2, 0.2), BASE),
    case("rate_limit", (1 / 0.06,)),
    case("saturation", (1 / 0.6,)),
    case("deadband", (0.12,), (1,)),
    case("backlash", (0.2,)),
    case("quantization", (0.5,)),
    case("quantization", (0.051,), (4,)),  # finer than the starts of the search are close
    case("gain", (-0.2,)),
    case("asymmetric_gain.negative", (0.25,)),
    case("asymmetric_gain.positive", (0.25,)),
    case("gain_drift", (-0.9,), BASE),
    case("cross_axis_coupling", (0.15,), (2,)),
    case("frame_misalignment", (0.12,)),
    case("coulomb_friction", (0.06,), (0, 1)),
    case("viscous_drag", (0.16,), (1,)),
    case("quadratic_drag", (0.3,)),
    case("slip.turning", (0.4,)),
    case("slip.walking", (0.4,)),
    case("gravity_sag", (0.06,)),
    case("payload.own_motion", (0.4, 0.1, 6.0)),
    case("payload.inherited", (0.4, 0.1, 6.0)),
    case("slope", (0.12, -0.08)),
    case("body_frame_bias", (0.06,), (1,)),
    case("arm_base_coupling.acceleration", (0.35,)),
    case("arm_base_coupling.velocity", (0.2,)),
    case("arm_base_coupling.moment", (0.6,)),
    case("base_arm_coupling", (0.4,)),
    case("induced_velocity", (-0.4,)),
    case("centripetal", (0.12,)),
    case("rotation_centre", (0.1, 0.06)),
    case("reach_limit.horizontal", (1 / 0.9,)),
    case("reach_limit.spherical", (1 / 1.0,)),
    case("ground_contact", (0.9,)),  # 0.35 m: 0.75 m, the range of heights, below the lowest it is nil
    case("relative_smoothing.own_motion", (1.0,), phi=SMOOTH_ARM),
    case("relative_smoothing.body_frame", (1.0,)),
    case("integration_rule", (0.6,), tuple(range(6))),
    case("sampling_interval.constant", (0.12,)),
    case("sensor_delay", (0.6,), (3,)),
    case("sensor_scale", (0.15,), (4,)),
    case("sensor_bias", (0.3,), (6,)),
    case("sensor_bias.drift", (0.6,), (10,)),
]
UNSEEN = {
    "sampling_interval.stamped": "rows are evenly spaced here",
    "external_push.world_frame": "it acts for a while only: see below",
    "external_push.own_frame": "as well",
    "external_push.on_joint": "of an engine's joints: see test_engines",
    "constant_load": "as well",
    "nonlinear_spring": "of bodies that keep their place: see test_springs_and_stops",
    "joint_gravity": "as well",
    "output_limit.quantity": "as well",
    "output_limit.sensor": "as well",
    "stribeck_friction": "of bodies that keep their place: see test_dry_friction",
    "load_friction": "as well",
    "coulomb_friction.giving": "as well",
    "hysteresis.gradual": "as well",
    "hysteresis.sliding": "as well",
    "hysteresis.elastic": "as well",
    "tyre_slip.sideways": "of cars: see test_tyres",
    "tyre_slip.turning": "as well",
    "rectified_sensor": "speeds of robots are never shown without sign: see test_rectified",
}


def test_every_effect_is_planted() -> None:
    assert {c.values[0] for c in CASES} | set(UNSEEN) == set(KEYS)


@pytest.mark.long
@pytest.mark.parametrize(("key", "constants", "sites", "more"), CASES)
def test_planted_effects_are_named_with_their_constants(
    key: str, constants: tuple[float, ...], sites: tuple[int, ...], more: dict
) -> None:
    found = explain(*sessions(acting(key, constants, sites), RICH, **more))
    assert [m.hypothesis.effect.id for m in found.members] == [KEYS[key].id]
    (member,) = found.members
    assert member.odds[KEYS[key].id] > 0.9
    assert_explains(found, member)
    assert member.hypothesis.effect.key == key
    if key != "sensor_bias":  # of two positions only the difference counts: either may be off
        assert member.hypothesis.sites == sites
    sd = found.sd.constants
    for k, (constant, group) in enumerate(zip(KEYS[key].constants, member.hypothesis.groups, strict=True)):
        value, planted = float(found.fit.v.theta[group.entries[0]]), constants[k]
        if key == "ground_contact":  # its height is relative to the recorded ones
            value = constant.physical(value, 0, found.problem.scales)
            planted = constant.physical(planted, 0, SCALES)
        elif key == "sensor_bias":
            value = abs(value)
        assert value == pytest.approx(planted, abs=max(0.1 * abs(planted), 3 * sd[k]))


@pytest.mark.long
@pytest.mark.parametrize("noise", [4.0, 1.0, 0.3])
@pytest.mark.parametrize("seed", [RICH, 11, 12, 13])
def test_nothing_is_claimed_where_nothing_is_planted(seed: int, noise: float) -> None:
    found = explain(*sessions({}, seed, noise))
    assert not found.members
    assert not found.noise_effects
    assert not found.supports
    assert found.rounds[0].screening.p_value > LEVEL
    assert not np.asarray(found.fit.v.theta).any()


@pytest.mark.long
def test_a_wrong_parameter_is_refitted_and_no_effect_is_claimed() -> None:
    phi = PHI.copy()
    phi[0], phi[20], phi[21] = 0.15, 1.5, 1.3  # the base's memory, how far it turns, how far the hand goes
    found = explain(*sessions({}, RICH, phi=phi))
    assert not found.members
    sd = found.sd.phi
    for i in (0, 20, 21):
        assert float(found.fit.v.phi[i]) == pytest.approx(phi[i], abs=4 * sd[i])
        assert sd[i] < 0.05


# Effects that look alike


@pytest.mark.long
@pytest.mark.parametrize(
    ("key", "constants", "sites"),
    [
        ("delay", (0.25,), ARM), ("lag", (0.6,), ARM),
        ("saturation", (1 / 0.9,), (0,)), ("quadratic_drag", (0.08,), (0,)),
        ("gain", (-0.2,), (2,)),
    ],
    ids=["delay", "lag", "saturation", "quadratic_drag", "gain of the yaw rate"],
)  # fmt: skip
def test_where_two_effects_look_alike_the_true_one_is_among_the_credible(
    key: str, constants: tuple[float, ...], sites: tuple[int, ...]
) -> None:
    """Weak ones: as weak as can be seen. Of the yaw rate, a gain and a viscous drag are the same but for its memory."""
    found = explain(*sessions(acting(key, constants, sites), RICH))
    (member,) = found.members
    credible, total = [], 0.0
    for effect, p in member.odds.items():
        credible.append(effect)
        total += p
        if total > 0.95:
            break
    assert KEYS[key].id in credible


@pytest.mark.long
def test_two_effects_are_found_together() -> None:
    planted = {**acting("delay", (1.4,), BASE), **acting("gravity_sag", (0.1,))}
    found = explain(*sessions(planted, RICH))
    assert {m.hypothesis.effect.id for m in found.members} == {"delay", "gravity_sag"}
    truth = theta(planted)
    np.testing.assert_allclose(np.asarray(found.fit.v.theta), truth, atol=0.1 * truth.max(), rtol=0.1)
    assert all(m.odds[m.hypothesis.effect.id] > 0.9 for m in found.members)


@pytest.mark.long
@pytest.mark.parametrize("frame", ["world_frame", "own_frame"])
def test_a_push_during_a_stretch_is_found_with_its_time(frame: str) -> None:
    """And no drift in the robot's own frame, which is the same law but acts all the time."""
    pushed = acting(f"external_push.{frame}", (0.25,), (1,))
    found = explain(*sessions({}, RICH, during=pushed, from_s=6.0, to_s=8.0, only=1))
    (member,) = found.members
    assert member.hypothesis.effect.key == f"external_push.{frame}"
    assert member.hypothesis.sites == (1,)
    assert member.odds["external_push"] > 0.9
    assert isinstance(member.hypothesis.support, Window)
    assert member.hypothesis.support.session == 1
    assert member.hypothesis.support.from_s == pytest.approx(6.0, abs=0.3)
    assert member.hypothesis.support.to_s == pytest.approx(8.0, abs=0.3)
    edges = posterior.edges(found.problem, found.fit, member.hypothesis, member.hypothesis.support)
    for edge, truth in zip(edges, (6.0, 8.0), strict=True):
        low, high = edge["ci95"]
        assert low <= truth <= high
        assert high - low < 1.0
    assert value_of(found.fit.v, member.hypothesis.groups[0]) == pytest.approx(0.25, rel=0.15)


@pytest.mark.long
@pytest.mark.parametrize(
    ("key", "constant", "from_s", "session"),
    [("quadratic_drag", 0.25, 10.0, None), ("gain", -0.2, 10.0, None), ("quadratic_drag", 0.35, 5.0, 1)],
)
def test_what_is_nothing_over_all_sessions_is_found_with_its_beginning(
    key: str, constant: float, from_s: float, session: int | None
) -> None:
    """It acts at the end of every session, or of one, and is not seen where it is looked for in all of it."""
    found = explain(*sessions({}, RICH, during=acting(key, (constant,)), from_s=from_s, only=session))
    (member,) = found.members
    assert_explains(found, member)
    assert member.hypothesis.effect.key == key
    assert member.hypothesis.sites == (0,)
    match member.hypothesis.support:
        case From(hidden_restriction):
            assert session is None
        case Window(of, hidden_restriction, _):
            assert of == session
        case other:
            pytest.fail(f"it acts {other}")
    assert hidden_restriction == pytest.approx(from_s, abs=0.2)
    assert value_of(found.fit.v, member.hypothesis.groups[0]) == pytest.approx(constant, rel=0.15)


@pytest.mark.long
@pytest.mark.parametrize(
    ("key", "constant", "site", "rule"),
    [
        ("gain", -0.35, 4, "reach > 0.8 m"),
        ("cross_axis_coupling", 0.3, 2, "ee height < 0.55 m"),
        ("viscous_drag", 0.35, 1, "base |yaw rate| > 0.3 rad/s"),
    ],
)
def test_the_regime_is_found_in_which_an_effect_acts(key: str, constant: float, site: int, rule: str) -> None:
    name, side, edge, _ = rule.rsplit(" ", 3)
    number = [f.name for f in features(SPOT.layout)].index(name)
    regime = Regime(number, 1.0 if side == ">" else -1.0, float(edge))
    planted = acting(key, (constant,), (site,))
    found = explain(*sessions({}, RICH, during=planted, regime=regime))
    (member,) = found.members
    assert member.hypothesis.effect.key == key
    assert found.supports == (member.hypothesis.support,)
    truth, estimated = (inside(SPOT.layout, r, found.problem.chunks) for r in (regime, *found.regimes))
    assert (truth & estimated).sum() > 0.85 * (truth | estimated).sum()
    value, sd = value_of(found.fit.v, member.hypothesis.groups[0]), found.sd.constants[0]
    assert value == pytest.approx(constant, abs=max(0.1 * abs(constant), 3 * sd))
    acts = found.acting(found.fit)
    assert acts.regimes == found.regimes
    assert not acts.theta.any()
    assert acts.delta.any()


@pytest.mark.long
@pytest.mark.parametrize("reach", [1.1, 1.13])
def test_a_limit_that_is_seldom_reached_is_found(reach: float) -> None:
    """It acts in a few blocks of rows only, and between the starts of the search."""
    found = explain(*sessions(acting("reach_limit.horizontal", (1 / reach,)), RICH))
    (member,) = found.members
    assert_explains(found, member)
    assert member.hypothesis.effect.key == "reach_limit.horizontal"
    assert 1 / float(found.fit.v.theta[member.hypothesis.groups[0].entries[0]]) == pytest.approx(reach, rel=0.01)


def test_a_limit_is_fitted_from_where_it_stands_best_not_from_the_direction_that_gains_most() -> None:
    """Of a limit far too tight a part gains most, which no share of its constant is."""
    limit = next(c for c in hypotheses_of(SPOT, SCALES) if c.effect.key == "saturation")
    tested = ((2.13, 65.5, 685.8), (2.05, 65.2, 99.8), (2.0, 64.9, 3.0), (1.9, 0.0, 0.0))
    found = [Screened(limit, (c,), 0, gain, 90.0, power, power, c) for c, gain, power in tested]
    (chosen,) = promising(found)
    assert chosen.start == (2.05,)
    assert chosen.gain == 65.5


@pytest.mark.parametrize(
    ("by_session", "heldout", "there"),
    [
        ((1.0, 1.0, 1.0), 0.1, True),
        ((40.0, 40.0, 40.0), -30.0, True),
        ((40.0, 40.0, 40.0), -75.0, False),
        ((120.0, 1.0, -1.0), -5.0, False),
    ],
    ids=["held-out sessions gain", "all others gain more", "they lose too much", "one session speaks for it"],
)
def test_heldout_sessions_that_lose_are_outvoted_by_several_others_not_by_one(
    by_session: tuple[float, ...], heldout: float, there: bool
) -> None:
    training, _ = sessions({})
    of = problem(training)
    session = rows_of(of.chunks).session
    gains = np.array(by_session)[session] / np.bincount(session)[session]
    assert agrees(gains, heldout, of.chunks, 10.0) == there


def test_the_catalogue_has_no_effect_twice() -> None:
    assert len(KEYS) == len(CATALOGUE)
