"""Engines: tables along an estimated motion, unmeasured velocities, and a diagnosis on both."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from servos import JOINTS, Push, Servos, recorded

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.inference.explain import explain
from simgap.diagnosis.likelihood.linearised import tabulated
from simgap.diagnosis.likelihood.problem import Problem, evaluate, start, with_value
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.diagnosis.likelihood.unmeasured import guessed
from simgap.effects.augmented import Augmented
from simgap.effects.stepping import Given, next_state
from simgap.recordings import split
from simgap.simulators.tables import Inputs, Points, shifted, tabulate
from simgap.types import Sessions

ENGINE = Servos()


def points(rows: int) -> Points:
    rng = np.random.default_rng(0)
    state, command = rng.normal(0.0, 0.5, (rows, 4)), rng.normal(0.0, 0.5, (rows, ENGINE.parts, 2))
    terms = np.tile([0.1, 0.0, 0.2], (rows, 1))
    return Points(rng.normal(0.0, 0.1, 4), terms, state, command)


def test_a_table_is_the_engine_at_its_points() -> None:
    at = points(20)
    table = tabulate(ENGINE, at)
    augmented = Augmented(ENGINE)
    expected = ENGINE.rows(*at, np.zeros((20, 2)))
    for i in range(20):
        here = type(table)(*(jnp.asarray(a[i]) for a in table))
        given = Given(jnp.asarray(at.phi, jnp.float32), jnp.asarray(at.command[i]), here, jnp.asarray(at.terms[i]))
        np.testing.assert_allclose(next_state(augmented, here.state, given), expected[i], atol=1e-5)


def test_a_table_has_derivatives_by_what_moves_and_zeros_elsewhere() -> None:
    at = points(20)
    whole = tabulate(ENGINE, at)
    part = tabulate(ENGINE, at, Inputs(commands=False, efforts=True, terms=np.array([True, False, True])))
    for name in ("state", "command", "then", "by_state", "by_phi", "by_effort"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name))
    assert not part.by_command.any()
    assert not part.by_term[:, 1].any()
    np.testing.assert_array_equal(part.by_term[:, [0, 2]], whole.by_term[:, [0, 2]])


def test_derivatives_agree_with_differences_on_both_sides() -> None:
    at, table, nil = points(20), tabulate(ENGINE, points(20)), np.zeros((20, 2))
    for i in range(4):
        sides = [ENGINE.rows(at.phi, at.terms, at.state + d * np.eye(4)[i], at.command, nil) for d in (1e-4, -1e-4)]
        np.testing.assert_allclose(table.by_state[:, i], (sides[0] - sides[1]) / 2e-4, atol=0.01)
        sides = [ENGINE.rows(at.phi + d * np.eye(4)[i], at.terms, at.state, at.command, nil) for d in (1e-4, -1e-4)]
        np.testing.assert_allclose(table.by_phi[:, i], (sides[0] - sides[1]) / 2e-4, atol=0.01)


def test_a_shifted_table_is_the_engine_at_its_new_points_with_its_old_derivatives() -> None:
    at = points(20)
    table = tabulate(ENGINE, at)
    moved = at._replace(phi=at.phi + 0.05, state=at.state + 0.01)
    there, expected = shifted(ENGINE, moved, table), ENGINE.rows(*moved, np.zeros((20, 2)))
    np.testing.assert_array_equal(there.by_phi, table.by_phi)
    of_terms = np.einsum("nk,nks->ns", at.terms, there.by_term) + np.einsum(
        "nk,nks->ns", at.terms**2, there.by_term_squared
    )
    np.testing.assert_allclose(there.then + moved.phi @ there.by_phi + of_terms, expected, atol=1e-5)


@pytest.mark.long
def test_tables_for_one_fit_serve_it_like_tables_for_all() -> None:
    sessions = Sessions(*split(recorded((0.3, 0.0, 0.0), sessions=4, rows=80)))
    augmented = Augmented(ENGINE)
    chunks = cut(sessions.fitted, ENGINE.time_step)
    problem = Problem(augmented, measure(augmented, sessions.fitted), chunks, np.eye(4))
    v = start(problem)
    (friction,) = [h for h in hypotheses_of(augmented, problem.scales) if h.name == "coulomb_friction on shoulder"]
    v = with_value(v, friction.groups[0], 0.2)
    found = []
    for fits in ((), (evaluate(problem, v, friction.groups),)):
        at = problem._replace(chunks=tabulated(problem, v, chunks, fits))
        near = with_value(v, friction.groups[0], 0.25)._replace(phi=v.phi + np.float32(0.02))
        found.append(evaluate(at, near, friction.groups).e)
    np.testing.assert_array_equal(*found)


def test_equal_rows_of_a_batch_are_stepped_once(monkeypatch: pytest.MonkeyPatch) -> None:
    at, stepped = points(3), []
    rows = Servos.rows

    def counted(self: Servos, phi: np.ndarray, terms: np.ndarray, *given: np.ndarray) -> np.ndarray:
        stepped.append(len(terms))
        return rows(self, phi, terms, *given)

    monkeypatch.setattr(Servos, "rows", counted)
    again = np.array([0, 1, 2, 2, 2, 0])

    def step(state: jax.Array, command: jax.Array, terms: jax.Array) -> jax.Array:
        return next_state(Augmented(ENGINE), state, Given(jnp.asarray(at.phi), command, None, terms))

    found = jax.vmap(step)(*(jnp.asarray(a[again], jnp.float32) for a in (at.state, at.command, at.terms)))
    assert stepped == [3]
    np.testing.assert_allclose(found, rows(ENGINE, *at, np.zeros((3, 2)))[again], atol=1e-5)


def test_an_engine_steps_itself_where_there_is_no_table() -> None:
    at = points(1)
    given = Given(*(jnp.asarray(a) for a in (at.phi, at.command[0])), None, jnp.asarray(at.terms[0]))
    found = next_state(Augmented(ENGINE), jnp.asarray(at.state[0], jnp.float32), given)
    np.testing.assert_allclose(found, ENGINE.rows(*at, np.zeros((1, 2)))[0], atol=1e-5)


def test_an_engine_expresses_its_own_effects() -> None:
    keys = [e.key for e in Augmented(ENGINE).catalogue]
    assert keys.count("coulomb_friction") == 1
    assert "joint_gravity" in keys
    assert "integration_rule" not in keys
    assert "delay" in keys


def test_a_velocity_without_a_column_is_guessed_and_no_measurement() -> None:
    engine = Servos(velocities=False)
    (measured,), (whole,) = (recorded(velocities=v, sessions=1, rows=100) for v in (False, True))
    layout = Augmented(engine).layout
    assert [f.name for f in layout.schema.outputs] == [f"{j}_pos" for j in JOINTS]
    assert layout.schema.columns == ("time_s", "shoulder_pos", "elbow_pos", "cmd_shoulder", "cmd_elbow")
    ((full,), *_) = guessed(engine, Sessions([measured], []))
    np.testing.assert_array_equal(full.state[:, :2], measured.state)
    assert np.corrcoef(full.state[:, 2], whole.state[:, 2])[0, 1] > 0.95


@pytest.mark.long
@pytest.mark.parametrize("velocities", [True, False])
def test_friction_of_a_joint_is_named_alone(velocities: bool) -> None:
    recordings = recorded((0.3, 0.0, 0.0), velocities=velocities, sessions=4, rows=160)
    found = diagnose(Servos(velocities=velocities), "servos", Sessions(*split(recordings)))
    (effect,) = found.statement["effects"]
    assert (effect["id"], effect["where"]) == ("coulomb_friction", "shoulder")
    assert effect["constants"][0]["value"] == pytest.approx(0.3, rel=0.1)


@pytest.mark.long
def test_where_only_parameters_were_far_off_the_innovations_of_the_fit_are_decorrelated_and_nothing_is_named() -> None:
    far = (1.0, -0.9, 0.9, 0.9)
    recordings = recorded(phi=far, sessions=4, rows=160)
    found = explain(Servos(), Sessions(*split(recordings)), np.random.default_rng(0), print)
    assert not found.anything
    np.testing.assert_allclose(found.fit.v.phi, far, atol=0.05)
    np.testing.assert_allclose(np.corrcoef(found.fit.e.T), np.eye(4), atol=0.15)


@pytest.mark.long
@pytest.mark.parametrize(
    ("pushed", "key"),
    [(Push(0.3), "constant_load"), (Push(0.6, session=0, rows=range(60, 110)), "external_push.on_joint")],
    ids=["load", "push"],
)
def test_a_load_on_a_joint_is_named_alone(pushed: Push, key: str) -> None:
    recordings = recorded(sessions=4, rows=160, pushed=pushed)
    found = diagnose(Servos(), "servos", Sessions(*split(recordings)))
    (effect,) = found.statement["effects"]
    assert (f"{effect['id']}.{effect['form']}".strip("."), effect["where"]) == (key, "shoulder_vel")
    assert effect["constants"][0]["value"] == pytest.approx(pushed.load, rel=0.1)
