"""An experiment moves what its question is about, within what was recorded, or there is none and a reason why."""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
import pytest
from test_numerics import known, optimised, posed
from test_ranges import driven

from examples.drive import DRIVE, PARAMETERS, Drive
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.fitting.model import Model
from simgap.diagnosis.likelihood.problem import Problem, evaluate, start, whitening
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.unmeasured import guessed
from simgap.diagnosis.report.experiment import SETTLED, Experiment, NoExperiment, design
from simgap.effects.augmented import Augmented
from simgap.effects.regime import EVERYWHERE
from simgap.types import Field, Parameter, Recording, Schema, Sessions

pytestmark = pytest.mark.long


def _cart(body: str) -> tuple[Field, Field]:
    position = Field(f"{body}_p", "m", "position", "world", body, "x")
    return position, Field(f"{body}_v", "m/s", "velocity", "world", body, "x")


SCHEMA = Schema(
    state=(*_cart("left"), *_cart("right")),
    command=tuple(Field(f"cmd_{body}", "N", "force", "world", body, "x") for body in ("left", "right")),
)


@dataclass(frozen=True)
class Pair:
    """Two drives side by side that have nothing to do with each other."""

    time_step: float = 0.02
    schema: Schema = SCHEMA
    parameters: tuple[Parameter, ...] = PARAMETERS

    def step(self, params, state, command):
        one = Drive(self.time_step).step
        return jnp.concatenate([one(params, state[:2], command[:1]), one(params, state[2:], command[1:])])


def side_by_side() -> list[Recording]:
    return [
        Recording(a.name, a.time_s, np.hstack([a.state, b.state]), np.hstack([a.command, b.command]))
        for a, b in zip(driven((2.0, 4.0), seed=1), driven((2.0, 4.0), seed=2), strict=True)
    ]


@pytest.fixture(scope="module")
def pair() -> Model:
    return optimised(posed(Pair(), side_by_side()))


def proposed(model: Model, one: tuple[str, float], other: tuple[str, float], recordings) -> Experiment | NoExperiment:
    """To separate two laws at a strength each."""
    about = [known(model.problem, name) for name, _ in (one, other)]
    fits = [
        evaluate(model.problem, vary(model.fit.v, c, (size,)), c.groups, model.fit.noise)
        for c, (_, size) in zip(about, (one, other), strict=True)
    ]
    return design(model.problem, fits[0], fits[1], about, (EVERYWHERE,), recordings)


def test_it_moves_the_channel_that_the_question_is_about(pair: Model) -> None:
    # Their fits differ in nothing but the right cart, where the left is easily moved as well.
    found = proposed(pair, ("coulomb_friction on right_v", 1.0), ("viscous_drag on right_v", 0.8), side_by_side())
    assert isinstance(found, Experiment)
    assert np.abs(found.commands[:, 1]).max() > 0
    assert SETTLED < found.nats < 1e5


def test_a_difference_in_another_channel_is_no_experiment_about_this_one(pair: Model) -> None:
    """Where the fits differ by what happens on the left, no command on the right shows it."""
    about = [known(pair.problem, name) for name in ("coulomb_friction on right_v", "viscous_drag on right_v")]
    left = known(pair.problem, "coulomb_friction on left_v")
    fits = [evaluate(pair.problem, vary(pair.fit.v, left, (size,)), left.groups, pair.fit.noise) for size in (0.0, 1.0)]
    found = design(pair.problem, fits[0], fits[1], about, (EVERYWHERE,), side_by_side())
    if isinstance(found, Experiment):
        assert np.abs(found.commands[:, 1]).max() > 0


def test_where_speeds_are_not_recorded_their_effect_is_seen_in_positions() -> None:
    """At the truth, so that the question is what an experiment would show."""
    state = tuple(replace(f, observed=f.kind == "position") for f in DRIVE.schema.state)
    simulator = replace(DRIVE, schema=Schema(state, DRIVE.schema.command))
    seen = [r._replace(state=r.state[:, :1]) for r in driven((2.0, 4.0), seed=1)]
    recordings = guessed(simulator, Sessions(seen, [])).fitted
    augmented = Augmented(simulator)
    of = Problem(augmented, measure(augmented, recordings), cut(recordings, 0.02), np.eye(1))
    model = optimised(of._replace(whiten=whitening(evaluate(of, start(of), ()).e)))
    found = proposed(model, ("coulomb_friction on velocity", 1.0), ("viscous_drag on velocity", 0.2), recordings)
    assert isinstance(found, Experiment), found.reason
    assert np.abs(found.commands).max() > 0


def test_two_laws_that_are_one_have_no_experiment(pair: Model) -> None:
    found = proposed(pair, ("viscous_drag on right_v", 0.5), ("viscous_drag on right_v", 0.5), side_by_side())
    assert isinstance(found, NoExperiment)
    assert "0.0 nats" in found.reason


def test_a_pair_that_diverges_is_no_evidence(pair: Model) -> None:
    found = proposed(pair, ("viscous_drag on right_v", 0.5), ("viscous_drag on right_v", 1e6), side_by_side())
    assert not isinstance(found, Experiment) or found.nats < 1e5
