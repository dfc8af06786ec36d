"""Dry friction and its relatives: planted by other code and named, and the laws of hysteresis by their definitions."""

from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint import JOINT, NOISE, freely, recorded
from stated import check_named_alone, stated

from examples.car import CAR
from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.inference.search.one_more import _of_one_kind
from simgap.diagnosis.likelihood.scales import measure
from simgap.effects import CATALOGUE, dry_friction, hysteresis
from simgap.effects.augmented import Augmented, Slot
from simgap.effects.hysteresis import _dahl, _elastic, _maxwell
from simgap.effects.regime import Acting
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.spot import Spot
from simgap.types import Recording

Most = Callable[[float, float], float]
Slope = Callable[[float, float], float]
FORCE, LENGTH = 1.0, 0.25


def rubbing(rng: np.random.Generator, most: Most) -> Recording:
    """A friction of at most `most(speed, torque)`, which holds the joint where it can."""

    def follows(q: float, w: float, torque: float, h: float) -> tuple[float, float]:
        _, free = freely(q, w, torque, h)
        w = 0.0 if abs(free) < h * most(w, torque) else free - np.sign(free) * h * most(w, torque)
        return q + h * w, w

    return recorded(rng, follows)


def bending(rng: np.random.Generator, slope: Slope, length: float = LENGTH) -> Recording:
    """Bristles, bent by z, whose bend changes by `slope(z, sign of the speed)` in a length."""
    z = 0.0

    def follows(q: float, w: float, torque: float, h: float) -> tuple[float, float]:
        nonlocal z
        z += h * w / length * slope(z, np.sign(w))
        return freely(q, w, torque - FORCE * z, h)

    return recorded(rng, follows)


SLOPES: dict[str, Slope] = {
    "gradual": lambda z, sign: 1 - z * sign,
    "sliding": lambda z, sign: float(z * sign < 1),
    "elastic": lambda z, sign: 1 + max(-z * sign, 0.0),
}
LAWS = {"gradual": _dahl, "sliding": _maxwell, "elastic": _elastic}
BRISTLES = {"force": FORCE, "length": LENGTH}
SPRING = {"stiffness": FORCE / LENGTH, "length": LENGTH}


@pytest.mark.long
@pytest.mark.parametrize(("form", "constants"), [("gradual", BRISTLES), ("sliding", BRISTLES), ("elastic", SPRING)])
def test_hysteresis_is_named_with_its_constants(form: str, constants: dict[str, float]) -> None:
    check_named_alone(stated(JOINT, bending, 0, slope=SLOPES[form]), f"hysteresis.{form}", constants)


@pytest.mark.long
def test_what_builds_up_within_a_few_readings_is_dry_friction() -> None:
    (named,) = stated(JOINT, bending, 0, slope=SLOPES["sliding"], length=NOISE)["effects"]
    assert named["id"] == "coulomb_friction"
    assert named["constants"][0]["value"] == pytest.approx(FORCE, rel=0.05)


def test_a_simulator_that_sees_one_state_takes_it_to_have_moved_as_it_does() -> None:
    """So the force is built up, but for a while after a reversal."""
    recording = bending(np.random.default_rng(0), SLOPES["sliding"], length=0.02)
    augmented, theta = Augmented(JOINT), np.zeros(len(Augmented(JOINT).slots), np.float32)
    law = [e.key for e in CATALOGUE].index("hysteresis.sliding")
    for k, value in enumerate((FORCE, 0.02)):
        theta[augmented.index[Slot(law, k, 0)]] = value
    acting = Acting(theta, np.zeros((0, len(theta)), np.float32), ())
    with_it = AugmentedSimulator.of(JOINT, acting, measure(augmented, [recording]))
    x, u = (jnp.asarray(a, jnp.float32) for a in (recording.state, recording.command))
    steps = [jax.vmap(s.step, (None, 0, 0))(jnp.array([0.5]), x[:-1], u[:-1]) for s in (JOINT, with_it)]
    off = [float(jnp.median(jnp.abs(then - x[1:])[:, 1])) for then in steps]
    assert off[1] < 2 * NOISE < off[0] / 5


def test_several_dry_frictions_are_one_that_stops_and_does_not_turn_back() -> None:
    """A Coulomb friction and one in proportion to the load: slow motion ends, fast motion slows by their sum."""
    augmented = Augmented(JOINT)
    scales = measure(augmented, [recorded(np.random.default_rng(0))])

    def speed_after(w: float, **constants: float) -> float:
        theta = np.zeros(len(augmented.slots), np.float32)
        for key, value in constants.items():
            law = next(i for i, e in enumerate(augmented.catalogue) if e.key == key)
            theta[augmented.index[Slot(law, 0, 0)]] = value
        acting = Acting(theta, np.zeros((0, len(theta)), np.float32), ())
        robot = AugmentedSimulator.of(JOINT, acting, scales)
        return float(robot.step(jnp.array([0.5]), jnp.array([0.0, w]), jnp.array([2.0]))[1])

    both = {"coulomb_friction": 2.0, "load_friction": 0.8}
    assert speed_after(-0.055) < -0.01
    assert speed_after(-0.055, **both) == pytest.approx(0.0, abs=1e-6)
    alone = [speed_after(5.0) - speed_after(5.0, **{key: value}) for key, value in both.items()]
    assert min(alone) > 0.02
    assert speed_after(5.0) - speed_after(5.0, **both) == pytest.approx(sum(alone), rel=1e-4)


def test_a_place_has_one_law_of_dry_friction() -> None:
    """Two would only mend each other's form. Another joint may have another one."""
    augmented = Augmented(JOINT)
    scales = measure(augmented, [recorded(np.random.default_rng(0))])
    laws = {c.effect.key: c for c in hypotheses_of(augmented, scales)}
    kind = [
        "coulomb_friction",
        "coulomb_friction.giving",
        "stribeck_friction",
        "hysteresis.gradual",
        "hysteresis.sliding",
    ]
    for one in kind:
        others = [key for key in laws if _of_one_kind(laws[one], laws[key])]
        assert sorted(others) == sorted(set(kind) - {one})
    elsewhere = laws[kind[0]]._replace(outputs=("another",))
    assert not any(_of_one_kind(elsewhere, laws[key]) for key in kind)


@pytest.mark.long
@pytest.mark.parametrize(
    ("key", "most", "constants"),
    [
        ("coulomb_friction", lambda w, u: 0.5, {"loss": 0.5}),  # noqa: ARG005 # and not as one that extends it
        ("load_friction", lambda w, u: 0.15 * abs(u), {"ratio": 0.15}),  # noqa: ARG005
        (
            "stribeck_friction",
            lambda w, u: 0.3 + 0.6 * np.exp(-((w / 0.3) ** 2)),  # noqa: ARG005
            {"sliding loss": 0.3, "static excess": 0.6, "speed": 0.3},
        ),
    ],
)
def test_friction_is_named_with_its_constants(key: str, most: Most, constants: dict[str, float]) -> None:
    check_named_alone(stated(JOINT, rubbing, 0, most=most), key, constants)


def test_bodies_that_wander_have_coulomb_friction_only() -> None:
    of_others = {e.key for e in (*dry_friction.EFFECTS, *hysteresis.EFFECTS)} - {"coulomb_friction"}
    for robot in (Spot(), CAR):
        augmented = Augmented(robot)
        assert not of_others & {e.key for e, sites in zip(CATALOGUE, augmented.sites, strict=True) if sites}


# The laws of hysteresis

bends, ways = st.floats(-1, 1), st.floats(-4, 4)


@cache
def integrated(form: str, z: float, way: float) -> tuple[float, float]:
    """Bend at the end of a way and its mean there, in small steps."""
    steps, at, mean = 4000, z, 0.0
    for _ in range(steps):
        after = at + way / steps * SLOPES[form](at, np.sign(way))
        mean += (at + after) / 2 / steps
        at = after
    return at, mean


def bent(form: str, z: float, way: float) -> tuple[float, float]:
    end, mean = LAWS[form](jnp.array(z), jnp.array(way))
    return float(end), float(mean)


@pytest.mark.parametrize("form", LAWS)
@given(z=bends, way=ways)
@settings(max_examples=30, deadline=None)
def test_a_way_bends_as_its_equation_says(form: str, z: float, way: float) -> None:
    assert bent(form, z, way) == pytest.approx(integrated(form, z, way), abs=5e-3)


@pytest.mark.parametrize("form", LAWS)
@given(z=bends, way=ways, share=st.floats(0, 1))
@settings(max_examples=100, deadline=None)
def test_a_way_in_two_parts_is_the_same_way(form: str, z: float, way: float, share: float) -> None:
    """How fast it is gone does not matter."""
    halfway, first = bent(form, z, share * way)
    end, second = bent(form, halfway, (1 - share) * way)
    assert (end, share * first + (1 - share) * second) == pytest.approx(bent(form, z, way), abs=2e-4)


@pytest.mark.parametrize("form", LAWS)
@given(way=st.floats(0.01, 3))
@settings(max_examples=50, deadline=None)
def test_a_way_to_and_fro_takes_energy(form: str, way: float) -> None:
    z = 0.0
    for _ in range(20):  # until every round is like the one before
        z, _ = bent(form, bent(form, z, way)[0], -way)
    there, going = bent(form, z, way)
    back, coming = bent(form, there, -way)
    assert back == pytest.approx(z, abs=1e-3)
    assert way * (going - coming) > -1e-6
