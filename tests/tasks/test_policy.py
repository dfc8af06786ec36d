"""The stage `policy`: what identifies a policy, what an interruption leaves, a policy as a file and as a model."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from given import POLICY_SIZES

from simgap.formats.arrays import save_arrays
from simgap.formats.documents import read_json, write_json, write_text
from simgap.models import FittedSpot
from simgap.policies.actor import Actor
from simgap.simulators.spot import SCHEMA
from simgap.types import ConfigError, SimgapError
from tasks import policy, policy_pyfunc
from tasks.files.models import load_policy, save_model, save_policy
from tasks.fingerprint import POLICY, TRAINING, code_digest, modules_of, of_policy
from tasks.params import Params, load_params
from tasks.workspace import Cell, Workspace

ROOT = Path(__file__).parents[2]
PARAMS = load_params(ROOT / "params.yaml")
TINY = load_params(ROOT / "params.yaml", {"policy": POLICY_SIZES})
CELL = Cell("student_t", "sim_model", 40, 0)


class Killed(BaseException):
    """Stands for what ends a process."""


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    """A model, its record, and transitions."""
    found = Workspace(tmp_path, "virtual")
    phi = jnp.concatenate([jnp.full(6, 0.3), jnp.zeros(12), jnp.ones(6)])
    model = FittedSpot(phi, jnp.full(13, 1e-3), jnp.full(13, 3.0), jnp.float32(1 / 15))
    save_model(found.model(CELL), model)
    write_json(found.record(CELL), {"fingerprint": "of the model"})
    rows = np.random.default_rng(0).uniform(-0.5, 0.5, (200, 31)).astype(np.float32)
    for split in ("training", "test"):
        arrays = {"x": rows, "y": rows[:, :13], "session": np.zeros(200, np.int32)}
        save_arrays(found.transitions / f"{split}.npz", arrays)
    return found


def learn(workspace: Workspace, params: Params, report: Callable[[int, dict[str, float]], None]) -> None:
    policy._learn(workspace, CELL, params, of_policy(CELL, "m", "d", params, "c"), report, lambda: 0.0)


def ignore(_step: int, _metrics: dict[str, float]) -> None:
    """No report."""


def killed_at(step_at: int) -> Callable[[int, dict[str, float]], None]:
    def report(step: int, _metrics: dict[str, float]) -> None:
        if step >= step_at:
            raise Killed

    return report


def test_a_policy_killed_halfway_is_gone_on_with_to_the_same_result(workspace: Workspace, tmp_path: Path) -> None:
    learn(workspace, TINY, ignore)
    whole, curve = load_policy(workspace.policy(CELL)), read_json(workspace.policy_record(CELL))["curve"]
    workspace.policy(CELL).unlink()
    workspace.policy_record(CELL).unlink()

    with pytest.raises(Killed):
        learn(workspace, TINY, killed_at(curve["step"][1]))
    assert workspace.checkpoint(CELL).exists()
    assert not workspace.policy_record(CELL).exists()
    steps: list[int] = []
    learn(workspace, TINY, lambda step, _: steps.append(step))
    assert steps == curve["step"][1:]
    assert read_json(workspace.policy_record(CELL))["curve"] == curve
    resumed = load_policy(workspace.policy(CELL))
    np.testing.assert_array_equal(resumed.layers[0][0], whole.layers[0][0])
    np.testing.assert_array_equal(resumed.std, whole.std)
    assert not list(tmp_path.rglob("*checkpoint*")), "a finished policy needs none"


def test_a_checkpoint_of_other_parameters_is_not_gone_on_with(workspace: Workspace) -> None:
    with pytest.raises(Killed):
        learn(workspace, TINY, killed_at(400))
    # Other ones that are no part of what is compiled.
    other = load_params(ROOT / "params.yaml", {"policy": POLICY_SIZES}, {"policy": {"learning": {"plateau_gain": 0.5}}})
    steps: list[int] = []
    learn(workspace, other, lambda step, _: steps.append(step))
    assert len(steps) == TINY.policy.learning.evaluations


def test_fingerprints_change_with_what_a_policy_depends_on() -> None:
    def changed(**policy: object) -> Params:
        return load_params(ROOT / "params.yaml", {"policy": policy})

    farther = {"track": {"bounds": {"reach": 1.5}}}
    stopped = {"policy": {"environment": {"stopped": True}}}
    marks = [
        of_policy(CELL, "m", "d", PARAMS, "c"),
        of_policy(CELL._replace(seed=1), "m", "d", PARAMS, "c"),
        of_policy(CELL, "n", "d", PARAMS, "c"),
        of_policy(CELL, "m", "e", PARAMS, "c"),
        of_policy(CELL, "m", "d", changed(environment={"reward": {"action_weight": 0.2}}), "c"),
        of_policy(CELL, "m", "d", load_params(ROOT / "params.yaml", stopped), "c"),
        of_policy(CELL, "m", "d", load_params(ROOT / "params.yaml", stopped, farther), "c"),
        of_policy(CELL, "m", "d", PARAMS, "x"),
    ]
    assert len(set(marks)) == len(marks)
    for same in (changed(workers=9, seeds=[5]), load_params(ROOT / "params.yaml", farther)):
        assert of_policy(CELL, "m", "d", same, "c") == marks[0]


def test_code_of_policies_is_what_learning_them_imports() -> None:
    names = {path.stem for path in modules_of(POLICY)}
    assert {"learn", "sac", "replay", "reward", "environment", "bounds", "actor", "models", "spot"} <= names
    assert not names & {"follow", "references", "virtual_robot", "virtual_spot", "fsvgd"}
    assert not [p for p in modules_of(TRAINING) if p.parent.name == "policies"], "no model becomes stale by it"
    assert code_digest(POLICY) == code_digest(POLICY)


def test_a_policy_comes_back_from_its_file_and_acts_in_mlflows_tables(workspace: Workspace) -> None:
    rng = np.random.default_rng(0)
    layers = [(rng.normal(size=(24, 8)), rng.normal(size=8)), (rng.normal(size=(8, 12)), rng.normal(size=12))]
    actor = Actor(layers, rng.normal(size=24), rng.uniform(1, 2, 24), np.array([1.0, 0.8, 1.0, 0.8, 0.8, 0.8]))  # type: ignore[arg-type]
    path = workspace.policy(CELL)
    save_policy(path, actor)
    loaded = load_policy(path)
    np.testing.assert_array_equal(loaded.layers[1][0], layers[1][0])

    columns = policy.input_columns()
    table = pd.DataFrame(rng.uniform(-1, 1, (5, 27)), columns=list(columns), index=[7, 8, 9, 10, 11])
    commands = [field.name for field in SCHEMA.command]
    model = policy_pyfunc._load_pyfunc(str(path), {"inputs": list(columns), "outputs": commands})
    found = model.predict(table)
    row = jnp.asarray(table.iloc[2].to_numpy(), jnp.float32)
    expected = loaded.command(row[:12], row[12:24].reshape(2, 6), row[24:])
    np.testing.assert_allclose(found.loc[9, commands].to_numpy(float), expected, atol=1e-4)
    assert (np.abs(found.to_numpy()) <= np.asarray(actor.limit) + 1e-6).all()


def test_a_file_that_holds_no_policy_is_told_as_such(workspace: Workspace) -> None:
    with pytest.raises(SimgapError, match="holds no policy"):
        load_policy(workspace.model(CELL))


def test_what_the_grid_no_longer_has_is_removed_checkpoints_too(workspace: Workspace) -> None:
    gone = CELL._replace(seed=9)
    for cell in (CELL, gone):
        for path in (workspace.policy(cell), workspace.policy_record(cell), workspace.checkpoint(cell)):
            write_text(path, "")
    policy.remove_stale(workspace, [CELL])
    assert not [path for path in workspace.policies.iterdir() if gone.name in path.name]
    assert len(list(workspace.policies.iterdir())) == 3


def test_the_projects_parameters_are_the_papers() -> None:
    """[Hoffman et al. 2025, Table 1]."""
    learning, sac, reward = PARAMS.policy.learning, PARAMS.policy.sac, PARAMS.policy.environment.reward
    assert (learning.environment_steps, learning.episode_length, learning.steps_between_updates) == (2_500_000, 120, 16)
    assert (learning.environments, learning.evaluation_environments, learning.evaluations) == (64, 128, 20)
    assert (learning.updates, learning.min_replay, learning.max_replay) == (1024, 2048, 50_000)
    assert (sac.learning_rate_alpha, sac.learning_rate_policy, sac.learning_rate_q) == (1e-4, 1e-4, 1e-4)
    assert (sac.max_gradient_norm, sac.discounting, sac.batch_size, sac.tau) == (100.0, 0.99, 64, 0.005)
    assert (sac.policy_hidden_layers, sac.critic_hidden_layers) == ((64, 64), (64, 64))
    assert dataclasses.astuple(reward) == (0.15, 1.5, 0.1, 1.3, 1.3, 0.1, 2.0, 0.5, 1.5, 0.01, 0.1)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ({"environment": {"reward": {"weight": 1.0}}}, ["policy.environment", "unknown key weight"]),
        ({"learning": {"environment_steps": 3000}}, ["policy.learning", "environment_steps is 3000"]),
        ({"sac": {"tau": 0.0}}, ["policy.sac.tau: ", "greater than 0; it is 0.0"]),
        ({"environment": {"command_limit": [1.0]}}, ["policy.environment", "command_limit"]),
    ],
)
def test_wrong_parameters_are_named(override: dict[str, object], words: list[str]) -> None:
    with pytest.raises(ConfigError) as error:
        load_params(ROOT / "params.yaml", {"policy": override})
    assert all(word in str(error.value) for word in words), error.value
