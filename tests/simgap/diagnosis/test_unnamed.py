"""Laws without a name: their directions against runs, those that are there against chance, and what is said of them."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from outside import by_heading, by_speed_and_turn, unheard
from planted import SPOT
from small import RICH, problem, sessions

from examples.drive import DRIVE
from simgap.diagnosis.hypotheses.library import Quantity, dictionary, quantities, values
from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.fitting.model import Model
from simgap.diagnosis.inference.misfit.impulse_response import direction, echoes, evidence, hear
from simgap.diagnosis.inference.misfit.nonparametric import Law, nonparametric_law
from simgap.diagnosis.likelihood.problem import Problem, evaluate, start, trials, whitening, with_value
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.variables import Variables
from simgap.effects.augmented import Augmented
from simgap.types import Recording


def fitted(training: list[Recording]) -> Model:
    of = problem(training)
    of = of._replace(whiten=whitening(evaluate(of, start(of), ()).e))
    return Model(of, *optimise(of, evaluate(of, start(of), ())))


def law_in(recorded: list[Recording], seed: int = 0) -> Law:
    training, heldout = recorded[:-1], recorded[-1:]
    model = fitted(training)
    return nonparametric_law(
        model, cut(heldout, 1 / 15, least=len(model.problem.chunks.row)), np.random.default_rng(seed), print
    )


def drifting(of: Problem, v: Variables, where: str, size: float) -> Variables:
    """With a drift where the support is open."""
    (drift,) = (c for c in hypotheses_of(of.augmented, of.scales) if c.name == f"body_frame_bias on {where}")
    return with_value(v, drift.groups[0]._replace(support=1), size)


@pytest.mark.parametrize("where", ["base_vx", "base_wz", "ee_vz"])
def test_echoes_add_up_to_what_pushes_change_in_a_run(where: str) -> None:
    """With a memory of 0.5 and a trust of 0.5, half of a push is left in the next row, and so on."""
    of = problem(sessions({}, RICH)[0])
    v, push = start(of), np.random.default_rng(0).normal(size=of.chunks.gate.shape).astype(np.float32)
    open_by = of._replace(chunks=of.chunks._replace(gate=jnp.asarray(push)))
    ran = (trials(open_by, [drifting(of, v, where, 0.01)])[0] - trials(of, [v])[0]) / 0.01
    (made,) = direction(of, echoes(of, v)[where], [push[:, 0, :-1]])
    assert np.linalg.norm(made - ran) < 0.03 * np.linalg.norm(ran)


def test_along_the_worlds_axes_a_push_is_the_same_whichever_way_the_robot_looks() -> None:
    of = problem(sessions({}, RICH)[0])
    v = start(of)
    heading = np.asarray(of.chunks.state)[:, :, 2]
    ahead, across = np.cos(heading), -np.sin(heading)
    ran = sum(
        (trials(of._replace(chunks=of.chunks._replace(gate=push[:, None])), [drifting(of, v, where, 0.01)])[0]
         - trials(of, [v])[0]) / 0.01
        for where, push in (("base_vx", jnp.asarray(ahead)), ("base_vy", jnp.asarray(across)))
    )  # fmt: skip
    (made,) = direction(of, echoes(of, v)["base along the world's x"], [np.ones(of.chunks.gate.shape)[:, 0, :-1]])
    assert np.linalg.norm(made - ran) < 0.05 * np.linalg.norm(ran)


def test_what_is_heard_of_pushes_is_what_their_directions_say() -> None:
    of = problem(sessions({}, RICH)[0])
    v, rng = start(of), np.random.default_rng(0)
    n, s = evaluate(of, v, ()).e.shape
    root, residual = rng.uniform(0.5, 2.0, (n, s)).astype(np.float32), rng.normal(size=n * s).astype(np.float32)
    basis = np.linalg.qr(rng.normal(size=(n * s, 5)))[0].astype(np.float32)
    push, echo = rng.normal(size=of.chunks.gate.shape)[:, 0, :-1], echoes(of, v)["ee_vy"]
    score, power, _ = evidence(hear(of, echo, root, residual, basis), [push])
    d = (direction(of, echo, [push])[0] * root).reshape(-1)
    assert score.sum() == pytest.approx(-d @ residual, rel=1e-3)
    assert power.sum() == pytest.approx(d @ d - ((d @ basis) ** 2).sum(), rel=1e-3)


@pytest.mark.parametrize("augmented", [SPOT, Augmented(DRIVE)], ids=["spot", "drive"])
def test_every_quantity_has_a_name(augmented: Augmented) -> None:
    names = [q.name for q in quantities(augmented.layout)]
    assert len(set(names)) == len(names)


def test_functions_have_no_mean_and_do_not_explode_beyond_what_they_are_made_from() -> None:
    of = problem(sessions({}, RICH)[0])
    known, z = quantities(of.augmented.layout), values(of, start(of))
    assert z.shape[-1] == len(known)
    rows = z[np.asarray(of.chunks.counts)]
    functions = dictionary(known, rows)
    made = np.stack([f.of(rows) for f in functions])
    np.testing.assert_allclose(made.mean(1), 0, atol=1e-4)
    assert (made.std(1) > 0).mean() > 0.99
    far = np.stack([f.of(100 * rows) for f in functions])
    assert np.abs(far).max() < 40
    assert {n for f in functions for n in f.depends_on} <= {q.name for q in known}


def test_of_what_does_not_vary_there_is_no_function() -> None:
    known = [Quantity("rests"), Quantity("moves")]
    z = np.stack([np.full(50, 3.0), np.linspace(-1, 1, 50)], axis=1)
    assert {f.depends_on for f in dictionary(known, z)} == {("moves",)}


@pytest.mark.parametrize("seed", [1, 2])
def test_of_noise_there_is_no_law(seed: int) -> None:
    training, heldout = sessions({}, seed)
    assert law_in([*training, *heldout]).terms == ()


@pytest.mark.parametrize("bodies", [True, False], ids=["a drive", "no body"])
def test_a_simulator_needs_no_ground_and_no_body(bodies: bool) -> None:
    schema = DRIVE.schema
    if not bodies:
        loose = lambda fields: tuple(replace(f, body="", axis="") for f in fields)  # noqa: E731
        schema = replace(schema, state=loose(schema.state), command=loose(schema.command))
    recorded = [drive(seed) for seed in range(4)]
    augmented = Augmented(replace(DRIVE, schema=schema))
    of = Problem(augmented, measure(augmented, recorded), cut(recorded[:3], 0.02), np.eye(2))
    model = Model(of, *optimise(of, evaluate(of, start(of), ())))
    assert (
        nonparametric_law(
            model, cut(recorded[3:], 0.02, least=len(of.chunks.row)), np.random.default_rng(0), print
        ).terms
        == ()
    )


def drive(seed: int) -> Recording:
    """A session of a drive pushed back and forth, measured with noise."""
    rng = np.random.default_rng(seed)
    force = 5 * np.sin(np.arange(200) * 0.1 + seed)
    states = [np.zeros(2)]
    for u in force[:-1]:
        states.append(np.asarray(DRIVE.step(jnp.array([2.0, 4.0]), jnp.asarray(states[-1]), jnp.array([u]))))
    noisy = np.array(states) + rng.normal(size=(200, 2)) * [0.001, 0.01]
    return Recording(f"s{seed}", np.arange(200) * 0.02, noisy, force[:, None])


def test_a_product_of_two_speeds_is_found_with_its_axis_and_what_it_depends_on() -> None:
    """Which term comes first is not said: the hand's own speed, which the product has made, is as good to the second
    decimal, and processors differ about it."""
    terms = law_in(unheard(by_speed_and_turn, RICH)).terms
    assert {t.axis for t in terms} == {"ee_vz"}
    forward, turn = {"base forward speed", "cmd_base_vx"}, {"base yaw rate", "cmd_base_wz"}
    products = [set(t.depends_on) for t in terms if len(t.depends_on) == 2]
    assert products
    assert all(p & forward and p & turn for p in products)


def test_a_drift_along_the_worlds_axis_is_found_there() -> None:
    law = law_in(unheard(by_heading, RICH))
    assert law.terms[0].axis == "ee along the world's x"
    assert {n for t in law.terms for n in t.depends_on} & {"sine of base_yaw", "cosine of base_yaw"}
