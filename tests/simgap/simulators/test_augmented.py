"""A simulator with diagnosed effects in the simulator's place."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from simgap.diagnosis.likelihood.scales import measure
from simgap.effects import CATALOGUE
from simgap.effects.augmented import Augmented
from simgap.effects.command_filters import fading_of
from simgap.effects.effect import Scales
from simgap.effects.regime import Acting, Regime, everywhere, features
from simgap.recordings import decode_state, encode_state
from simgap.simulators import sample_parameters, state_difference
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.spot import SCHEMA, Spot, step
from simgap.types import Recording, Simulator

SPOT = Spot()
(PHI,) = sample_parameters(SPOT, jax.random.key(1), 1)
X = jax.random.normal(jax.random.key(2), (50, 31))


@cache
def scales() -> Scales:
    rng = np.random.default_rng(0)
    recording = Recording("made up", np.arange(60) / 15, rng.normal(size=(60, 12)), rng.normal(size=(60, 6)))
    return measure(Augmented(SPOT), [recording])


def with_effects(**constants: float) -> AugmentedSimulator:
    """The first constant of some effects, at all their sites."""
    augmented = Augmented(SPOT)
    theta = np.zeros(len(augmented.slots))
    for i, slot in enumerate(augmented.slots):
        if slot.constant == 0:
            theta[i] = constants.get(CATALOGUE[slot.effect].key, 0.0)
    return AugmentedSimulator.of(SPOT, everywhere(theta), scales())


def differences(simulator: Simulator, x: Array = X) -> Array:
    return jax.vmap(lambda x: state_difference(simulator, PHI, x))(x)


def previous(rows: int) -> Array:
    """The inputs with the command of some rows before as the one that acts."""
    return X.at[:, 25:].set(X[:, 25 - 6 * rows : 31 - 6 * rows])


def test_of_spot_the_difference_is_the_papers_equation_to_the_bit() -> None:
    def by_hand(x: Array) -> Array:
        return encode_state(SCHEMA, step(PHI, decode_state(SCHEMA, x[:13]), x[-6:], SPOT.time_step)) - x[:13]

    np.testing.assert_array_equal(jax.jit(differences, static_argnums=0)(SPOT, X), jax.jit(jax.vmap(by_hand))(X))


def test_without_effects_it_is_the_simulator() -> None:
    bare = with_effects()
    assert bare.effects == ()
    np.testing.assert_array_equal(differences(bare), differences(SPOT))
    state, command = decode_state(SCHEMA, X[0, :13]), X[0, -6:]
    np.testing.assert_array_equal(bare.step(PHI, state, command), SPOT.step(PHI, state, command))


def test_laws_that_are_nil_are_never_traced() -> None:
    operations = [
        len(jax.make_jaxpr(lambda x, s=s: state_difference(s, PHI, x))(X[0]).eqns) for s in (SPOT, with_effects())
    ]
    assert operations[1] < 1.5 * operations[0]


@pytest.mark.parametrize("rows", [1, 2])
def test_a_dead_time_of_whole_rows_takes_the_command_of_those_rows_before(rows: int) -> None:
    np.testing.assert_allclose(
        differences(with_effects(delay=float(rows))), differences(SPOT, previous(rows)), atol=1e-6
    )


def test_a_dead_time_beyond_the_history_takes_its_oldest_command() -> None:
    np.testing.assert_allclose(differences(with_effects(delay=5.0)), differences(SPOT, previous(2)), atol=1e-6)


def test_a_lag_has_settled_on_the_oldest_command() -> None:
    oldest, before, now = (X[:, 13 + 6 * k : 19 + 6 * k] for k in range(3))
    begins = before + np.exp(-1 / 0.4) * (oldest - before)
    # What comes late in a row weighs more in the velocity at its end: by midpoints of the row.
    into_row = (jnp.arange(1000) + 0.5) / 1000
    weights = jnp.exp(fading_of(SPOT, Augmented(SPOT).layout, PHI) * into_row[:, None])
    missed = (weights * jnp.exp(-into_row / 0.4)[:, None]).sum(0) / weights.sum(0)
    np.testing.assert_allclose(
        differences(with_effects(lag=0.4)), differences(SPOT, X.at[:, 25:].set(now + missed * (begins - now))),
        rtol=1e-4, atol=1e-5,
    )  # fmt: skip


def test_a_biased_output_changes_as_the_true_one_does() -> None:
    biased = with_effects(sensor_bias=0.3)
    measured = decode_state(SCHEMA, X[0, :13])
    expected = SPOT.step(PHI, measured - 0.3, X[0, -6:]) + 0.3
    np.testing.assert_allclose(biased.step(PHI, measured, X[0, -6:]), expected, atol=1e-5)
    late = with_effects(sensor_delay=1.0)
    np.testing.assert_allclose(differences(late), differences(SPOT), atol=1e-5)


def test_in_a_regime_other_constants_hold() -> None:
    outside, inside = with_effects(delay=1.0), with_effects(delay=2.0, viscous_drag=0.1)
    reach = [f.name for f in features(outside.augmented.layout)].index("reach")
    delta = inside.acting.theta - outside.acting.theta
    acting = Acting(outside.acting.theta, delta[None], (Regime(reach, 1.0, 0.8),))
    simulator = AugmentedSimulator.of(SPOT, acting, scales())
    far = np.linalg.norm(X[:, 7:9] - X[:, :2], axis=1) > 0.8
    assert 5 < far.sum() < 45
    expected = np.where(far[:, None], differences(inside), differences(outside))
    np.testing.assert_allclose(differences(simulator), expected, atol=1e-6)
    assert set(simulator.effects) == {"delay", "viscous_drag"}


def test_effects_in_two_regimes_add_up_where_both_hold() -> None:
    names = [f.name for f in features(Augmented(SPOT).layout)]
    far, fast = Regime(names.index("reach"), 1.0, 0.8), Regime(names.index("base speed"), 1.0, 0.5)
    plain, late, dragged = with_effects(), with_effects(delay=1.0), with_effects(viscous_drag=0.1)
    acting = Acting(plain.acting.theta, np.stack([late.acting.theta, dragged.acting.theta]), (far, fast))
    simulator = AugmentedSimulator.of(SPOT, acting, scales())
    x = np.asarray(X)
    is_far = np.linalg.norm(x[:, 7:9] - x[:, :2], axis=1) > 0.8
    is_fast = np.linalg.norm(x[:, 4:6], axis=1) > 0.5
    expected = np.asarray(differences(plain)).copy()
    for where, there in (
        (is_far & ~is_fast, late), (~is_far & is_fast, dragged),
        (is_far & is_fast, with_effects(delay=1.0, viscous_drag=0.1)),
    ):  # fmt: skip
        assert where.any()
        expected[where] = np.asarray(differences(there))[where]
    np.testing.assert_allclose(differences(simulator), expected, atol=1e-6)


def test_it_is_known_when_compiled_and_differentiable_in_the_parameters() -> None:
    simulator = with_effects(delay=1.0, viscous_drag=0.1, backlash=0.2)
    again = with_effects(delay=1.0, viscous_drag=0.1, backlash=0.2)
    assert simulator == again
    assert hash(simulator) == hash(again)
    assert simulator != with_effects(delay=1.0)
    assert set(simulator.effects) == {"delay", "viscous_drag", "backlash"}
    for one, other in zip(simulator.scales, scales(), strict=True):
        np.testing.assert_array_equal(one, other)

    loss = jax.jit(lambda phi, simulator: state_difference(simulator, phi, X[0]).sum(), static_argnums=1)
    gradient = jax.grad(loss)(PHI, simulator)
    assert jnp.isfinite(gradient).all()
    assert (gradient != 0).any()


def test_constants_of_another_simulator_are_refused() -> None:
    with pytest.raises(ValueError, match="theta"):
        AugmentedSimulator.of(SPOT, everywhere(np.zeros(3)), scales())
