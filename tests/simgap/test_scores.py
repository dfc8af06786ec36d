"""Scores against scipy, and a perfect model against itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp

from simgap import scores
from simgap.models import FittedSpot
from simgap.simulators.spot import SCHEMA, step
from simgap.types import Prediction, Recording

RNG = np.random.default_rng(0)
MEAN, SCALE, Y = RNG.normal(size=(3, 4)), np.array([0.5, 1.0, 2.0, 0.1]), RNG.normal(size=4)


@pytest.mark.parametrize("dof", [np.inf, 4.0])
def test_joint_density_is_the_mixtures(dof: float) -> None:
    frozen = [[stats.t(dof, m, s) if np.isfinite(dof) else stats.norm(m, s) for m, s in zip(row, SCALE, strict=True)]
              for row in MEAN]  # fmt: skip
    expected = logsumexp([sum(d.logpdf(y) for d, y in zip(row, Y, strict=True)) for row in frozen]) - np.log(3)
    prediction = Prediction(*map(jnp.asarray, (MEAN, SCALE, np.full(4, dof))))
    assert float(scores.joint_log_density(prediction, jnp.asarray(Y))) == pytest.approx(expected, rel=1e-4)
    cdf = np.mean([[d.cdf(y) for d, y in zip(row, Y, strict=True)] for row in frozen], axis=0)
    np.testing.assert_allclose(scores.cumulative(prediction, jnp.asarray(Y)), cdf, atol=1e-4)


def test_calibration_error_of_right_and_wrong_error_bars() -> None:
    z = RNG.normal(size=(5000, 2))
    assert scores.calibration_error(stats.norm.cdf(z)) < 0.01
    assert scores.calibration_error(stats.norm.cdf(z / 3)) > 0.08
    assert scores.calibration_error(np.zeros((100, 2))) == pytest.approx(0.5)


def perfect() -> tuple[FittedSpot, Recording]:
    """A session that the kinematic model made, and that model."""
    phi = jnp.concatenate([jnp.full(6, 0.3), jnp.zeros(12), jnp.ones(6)])
    commands = jnp.asarray(RNG.uniform(-0.5, 0.5, (80, 6)), jnp.float32)
    start = jnp.zeros(12).at[6].set(0.8).at[8].set(0.6)

    def advance(s, u):
        return step(phi, s, u, 1 / 15), s

    _, states = jax.lax.scan(advance, start, commands)
    model = FittedSpot(phi, jnp.full(13, 0.01), jnp.full(13, jnp.inf), jnp.asarray(1 / 15))
    return model, Recording("perfect", np.arange(80) / 15, np.asarray(states), np.asarray(commands))


def test_rollout_of_the_true_model_is_the_recording() -> None:
    model, recording = perfect()
    errors = scores.multi_step(model, SCHEMA, [recording], (10, 50), stride=5)
    assert set(errors) == {"rollout_base_10", "rollout_base_50", "rollout_ee_10", "rollout_ee_50"}
    assert max(errors.values()) < 1e-3


def test_a_wrong_model_errs_more_the_longer_it_runs() -> None:
    model, recording = perfect()
    wrong = model._replace(params=model.params.at[18:].set(1.5))
    errors = scores.multi_step(wrong, SCHEMA, [recording], (10, 50), stride=5)
    assert 0.01 < errors["rollout_ee_10"] < errors["rollout_ee_50"]


def test_sessions_too_short_for_a_rollout_are_passed_over() -> None:
    model, recording = perfect()
    short = Recording("short", recording.time_s[:20], recording.state[:20], recording.command[:20])
    assert np.isnan(list(scores.multi_step(model, SCHEMA, [short], (10, 50), stride=5).values())).all()
    both = scores.multi_step(model, SCHEMA, [short, recording], (10, 50), stride=5)
    assert both == scores.multi_step(model, SCHEMA, [recording], (10, 50), stride=5)
