"""The model with a residual on robots whose truth is known: coordinates, durations, choice, rollouts."""

import dataclasses
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from simgap import draws, fsvgd, models, prediction, scores
from simgap.domain import uniform_inputs
from simgap.noise import FAMILIES
from simgap.recordings import encode_state
from simgap.residual import body, duration, pace
from simgap.residual.config import Config
from simgap.residual.fit import equally_likely
from simgap.residual.learn import heldout, residual_model
from simgap.residual.model import ResidualModel, predict, steady
from simgap.simulators import sample_parameters, state_difference
from simgap.simulators.spot import SCHEMA, Spot, rotation
from simgap.types import ConfigError, Recording, Transitions

SPOT = Spot()
(PHI,) = sample_parameters(SPOT, jax.random.key(7), 1)
GAUSSIAN = FAMILIES["gaussian"]
BNN = fsvgd.Config(
    particles=3, batch_size=32, epochs=1, max_training_steps=1, learning_rate=1e-3, weight_decay=1e-3,
    hidden_layer_sizes=(32, 32), likelihood_exponent=1.0, bandwidth_svgd=5.0, validation_share=0.1,
    measurement_sets=32, evaluate_every=1, patience=1,
)  # fmt: skip
# One configuration and one number of rows for all: they share what is compiled, and most of what is learnt.
ROWS = 300
CONFIG = Config(
    simulator_steps=600, simulator_learning_rate=1e-2, simulator_batch=64, durations=8, outputscales=(0.01, 1.0),
    lengthscales=(3.0,), training_steps=600, evaluate_every=200, patience=400, measurement_points=16, heldout_share=0.2,
    paces=(0.8, 1.0, 1.3), horizon=10,
)  # fmt: skip


def truth(x: Array, steps: float = 1.0, bent: float = 0.0) -> Array:
    """A robot like the simulator whose rows may last several steps, and which a fast hand's own speed holds back."""
    change = duration.after(duration.path(SPOT, PHI, x), jnp.array([steps]))[0]
    held = -bent * jnp.tanh(3 * body.features(SPOT, x)[6:9])
    return change + steps * body.lift(SCHEMA, x)[:, 9:12] @ held


_outputs = jax.jit(jax.vmap(truth, (0, 0, None)))
_step = jax.jit(SPOT.step)
_features = jax.jit(partial(body.features, SPOT))
_steady = jax.jit(jax.vmap(steady, (None, 0)))


def rows(count: int, seed: int, bent: float = 0.0, stalls: bool = False) -> Transitions:
    """Of such a robot in six sessions; one row in four lasts three steps where it stalls."""
    recorded = 0.5 * draws.normal(jax.random.key(0), (200, 31))
    x = uniform_inputs(jax.random.key(seed), count, recorded, SPOT)
    steps = jnp.where(stalls & (jnp.arange(count) % 4 == 0), 3.0, 1.0)
    y = _outputs(x, steps, bent)
    return Transitions(x, y + 0.01 * draws.normal(jax.random.key(seed + 1), y.shape), jnp.arange(count) // 50 % 6)


def session(steps: float = 1.0, count: int = 40) -> Recording:
    """Commands that change slowly, rows that all last as long."""
    commands = np.repeat(np.random.default_rng(0).uniform(-0.5, 0.5, (count // 10, 6)), 10, axis=0)
    state, states = jnp.zeros(12).at[6].set(0.8), []
    move = jax.jit(lambda s, u: SPOT.step(PHI, s, u))
    after = jax.jit(lambda s, u: s + steps * (move(s, u) - s))
    for u in commands:
        states.append(np.asarray(state))
        state = after(state, jnp.asarray(u))
    return Recording("s", np.arange(count) / 15, np.stack(states), commands)


class Learnt(NamedTuple):
    """A model, and the steps and metrics that its learning told of."""

    model: ResidualModel
    told: list[tuple[int, dict[str, float]]]


def learn(data: Transitions) -> Learnt:
    told: list[tuple[int, dict[str, float]]] = []
    model = residual_model(jax.random.key(0), data, (session(),), SPOT, (CONFIG, BNN, GAUSSIAN),
                           lambda step, metrics: told.append((step, metrics)))  # fmt: skip
    return Learnt(model, told)


def nll(model: prediction.Model, data: Transitions) -> float:
    return scores.one_step(model, data, SCHEMA.encoded)["nll"]


def simulator_alone(model: ResidualModel) -> models.FittedSimulator:
    """What the data were made with, under the model's noise."""
    return models.FittedSimulator(SPOT, PHI, model.scale, model.dof)


@pytest.fixture(scope="module")
def described() -> Learnt:
    """Of a robot that the simulator describes."""
    return learn(rows(ROWS, 1))


@pytest.fixture(scope="module")
def exact(described: Learnt) -> ResidualModel:
    return described.model


@pytest.fixture(scope="module")
def held_back() -> Learnt:
    """Of a robot of which the simulator misses something."""
    return learn(rows(ROWS, 1, bent=0.2))


def test_features_are_the_same_wherever_the_robot_stands() -> None:
    x = rows(1, 3).x[0]
    turned, R = jnp.asarray(0.7), rotation(jnp.asarray(0.7))
    state = _step(PHI, jnp.zeros(12).at[6].set(0.7), jnp.full(6, 0.3))
    moved = jnp.concatenate([R @ state[:3], R @ state[3:6], R @ state[6:9], R @ state[9:]])
    moved = moved.at[2].set(state[2] + turned) + jnp.zeros(12).at[jnp.array([0, 1, 6, 7])].set(
        jnp.array([3.0, -2.0] * 2)
    )
    at = [jnp.concatenate([encode_state(SCHEMA, s), x[13:]]) for s in (state, moved)]
    np.testing.assert_allclose(_features(at[0]), _features(at[1]), atol=1e-5)
    assert _features(at[0]).shape == (9 + 18,)


def test_a_residual_along_the_bodys_axes_turns_with_it() -> None:
    x = rows(1, 4).x[0]
    J = body.lift(SCHEMA, x)
    np.testing.assert_allclose(J.T @ J, np.eye(12), atol=1e-5)
    yaw = jnp.arctan2(x[2], x[3])
    np.testing.assert_allclose(J @ jnp.eye(12)[0], jnp.zeros(13).at[:2].set(jnp.array([jnp.cos(yaw), jnp.sin(yaw)])),
                               atol=1e-5)  # fmt: skip


def test_a_row_of_several_steps_is_that_many_steps_with_the_command_held() -> None:
    x = rows(1, 5).x[0]
    once = state_difference(SPOT, PHI, x)
    then = x.at[:13].add(once).at[13:].set(jnp.concatenate([x[19:], x[-6:]]))
    twice = once + state_difference(SPOT, PHI, then)
    after = duration.after(duration.path(SPOT, PHI, x), jnp.array([0.0, 0.5, 1.0, 2.0, 9.0]))
    np.testing.assert_allclose(after[:4], jnp.stack([0 * once, once / 2, once, twice]), atol=1e-6)
    assert np.abs(after[4]).max() > np.abs(twice).max()  # beyond the steps that are run it goes on


@pytest.mark.long
def test_without_misfit_nothing_is_added(exact: ResidualModel) -> None:
    unseen = rows(ROWS, 11)
    none = dataclasses.replace(exact, particles=jax.tree.map(jnp.zeros_like, exact.particles))
    assert nll(exact, unseen) < nll(none, unseen) + 0.3
    assert nll(exact, unseen) < nll(simulator_alone(exact), unseen) + 1.0
    one, zero = jnp.ones(()), jnp.zeros(())
    ways = [dataclasses.replace(exact, pace=one, carried=carried) for carried in (one, zero)]
    means = [_steady(way, unseen.x) for way in ways]
    assert float(jnp.sqrt(jnp.mean((means[0] - means[1]) ** 2))) < 0.005  # half the noise
    np.testing.assert_allclose(exact.durations, 1.0, atol=0.15)


@pytest.mark.long
def test_what_the_simulator_misses_is_learnt(held_back: Learnt) -> None:
    model, unseen = held_back.model, rows(ROWS, 11, bent=0.2)
    none = dataclasses.replace(model, particles=jax.tree.map(jnp.zeros_like, model.particles))
    assert nll(model, unseen) < nll(none, unseen) - 1.0


def test_shares_become_as_many_equally_likely_durations() -> None:
    made = equally_likely(jnp.array([3.0, 1.0, 0.5, 2.0]), jnp.log(jnp.array([0.3, 0.6, 0.02, 0.08])))
    assert made.tolist() == [1.0, 1.0, 2.0, 3.0]  # at 1/8, 3/8, 5/8 and 7/8 of 0.02, 0.62, 0.7, 1
    assert equally_likely(jnp.array([1.0, 2.0]), jnp.zeros(2)).tolist() == [1.0, 2.0]


def test_two_rare_durations_are_not_lost_together() -> None:
    """A seventh of the rows stall, in two kinds; each alone has half of a share of an eighth."""
    law = {0.5: 0.24, 0.75: 0.24, 1.0: 0.24, 1.25: 0.15, 1.5: 0.0, 1.75: 0.0, 2.5: 0.065, 3.5: 0.065}
    made = equally_likely(jnp.array(list(law)), jnp.log(jnp.array(list(law.values()))))
    assert (made > 2).sum() == 1
    assert float(made.mean()) == pytest.approx(sum(d * share for d, share in law.items()), rel=0.1)


@pytest.mark.long
def test_rows_that_stall_are_found_and_their_number() -> None:
    model, unseen = learn(rows(ROWS, 1, stalls=True)).model, rows(ROWS, 11, stalls=True)
    np.testing.assert_allclose(model.durations, [1.0] * 6 + [3.0] * 2, atol=0.2)
    even = dataclasses.replace(model, durations=jnp.ones(8))
    assert nll(model, unseen) < nll(even, unseen) - 1.0


@pytest.mark.long
def test_long_predictions_keep_the_pace_of_the_sessions(exact: ResidualModel) -> None:
    model = dataclasses.replace(exact, params=PHI)
    assert float(pace.kept(model, [session(1.0)], CONFIG).pace) == 1.0
    assert float(pace.kept(model, [session(1.3)], CONFIG).pace) == pytest.approx(1.3)
    assert float(pace.kept(model, [session(0.8, 12)], CONFIG).pace) == pytest.approx(0.8)  # shorter than the horizon


@pytest.mark.long
def test_a_residual_that_does_long_predictions_no_good_is_not_carried(exact: ResidualModel) -> None:
    wrong = dataclasses.replace(exact, params=PHI, unit=exact.unit * 0 + 0.1)
    assert float(pace.kept(wrong, [session()], CONFIG).carried) == 0.0
    mean = steady(pace.kept(wrong, [session()], CONFIG), rows(1, 3).x[0])
    np.testing.assert_allclose(mean[0], state_difference(SPOT, PHI, rows(1, 3).x[0]), atol=1e-5)


@pytest.mark.long
def test_the_prediction_is_a_mixture_over_particles_and_durations(exact: ResidualModel) -> None:
    p = predict(exact, rows(1, 3).x[0])
    assert p.mean.shape == (3 * CONFIG.durations, 13)
    assert prediction.steady(exact, rows(1, 3).x[0]).shape == (3, 13)
    np.testing.assert_array_equal(prediction.predict(exact, rows(1, 3).x[0]).mean, p.mean)


def test_whole_sessions_are_held_out() -> None:
    sessions = jnp.array([0] * 30 + [1] * 20 + [4] * 50)
    held = heldout(jax.random.key(0), sessions, 0.2)
    assert 0.2 <= held.mean() < 1
    assert not set(np.asarray(sessions)[held]) & set(np.asarray(sessions)[~held])
    assert heldout(jax.random.key(0), jnp.zeros(10, int), 0.2).tolist() == [False] * 8 + [True] * 2
    one_of_two = heldout(jax.random.key(1), jnp.array([0, 1, 1, 1]), 0.9)
    assert 0 < one_of_two.sum() < 4


@pytest.mark.long
def test_the_scale_is_chosen_by_the_sessions_held_out(described: Learnt, held_back: Learnt) -> None:
    """Rows that miss a lot in a smooth way call for the larger scale; where there is only noise, the smaller one."""
    for told, bent in ((held_back.told, 0.2), (described.told, 0.0)):
        nlls = [(step, metrics.get("validation_nll", np.nan)) for step, metrics in told]
        small = min(v for s, v in nlls if 600 < s <= 1200)
        large = min(v for s, v in nlls if s > 1200)
        assert (large < small) == (bent > 0)
        assert [s for s, _ in nlls] == sorted(s for s, _ in nlls)


@pytest.mark.parametrize(
    "wrong", [{"durations": 0}, {"outputscales": ()}, {"paces": (1.0, -1.0)}, {"heldout_share": 1.0}]
)
def test_a_configuration_that_cannot_be_meant_is_named(wrong: dict) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        dataclasses.replace(CONFIG, **wrong)
