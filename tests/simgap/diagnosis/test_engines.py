"""Engines: tables along an estimated motion, unmeasured velocities, and a diagnosis on both."""

import jax.numpy as jnp
import numpy as np
import pytest
from servos import JOINTS, Push, Servos, recorded

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.inference.explain import split
from simgap.diagnosis.likelihood.unmeasured import guessed
from simgap.effects.augmented import Augmented
from simgap.effects.stepping import Given, next_state
from simgap.simulators.tables import Points, tabulate
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
    ((full,), _, _) = guessed(layout, Sessions([measured], []))
    np.testing.assert_array_equal(full.state[:, :2], measured.state)
    assert np.corrcoef(full.state[:, 2], whole.state[:, 2])[0, 1] > 0.95


@pytest.mark.parametrize("velocities", [True, False])
def test_friction_of_a_joint_is_named_alone(velocities: bool) -> None:
    recordings = recorded((0.3, 0.0, 0.0), velocities=velocities, sessions=4, rows=160)
    found = diagnose(Servos(velocities=velocities), "servos", Sessions(*split(recordings)))
    (effect,) = found.statement["effects"]
    assert (effect["id"], effect["where"]) == ("coulomb_friction", "shoulder")
    assert effect["constants"][0]["value"] == pytest.approx(0.3, rel=0.1)


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
