"""A recorded robot's stages at a tiny size: sessions in, a twin of it, and policies that run on the twin."""

from collections import Counter
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
import pytest
from drawn import drawn
from mlflow import MlflowClient
from test_pipeline import ROOT, TINY

from flows import policy, recordings, track, train, transitions, twin
from simgap.formats.documents import read_json
from simgap.formats.recordings import write_recording
from simgap.simulators import parameter_ranges
from simgap.simulators.spot import SCHEMA, Spot
from simgap.types import Recording, RecordingError, SimgapError
from tasks import twin as tasks_twin
from tasks.files.twins import load_twin
from tasks.params import Params, load_params
from tasks.twin import BLACK_BOX, KNOWN, SIM_MODEL, UNKNOWN
from tasks.workspace import TwinShare, Workspace

pytestmark = pytest.mark.long

CELLS = {"models": ["sim_model"], "sample_sizes": [40], "seeds": [0]}
OVERRIDES: dict[str, Any] = {
    **TINY,
    "recordings": {"mine": {"folder": "theirs", "training": ["driven/*"], "test": ["tests/*"], "further": ["axis/*"]}},
    "train": {**TINY["train"], **CELLS},
    "policy": {**TINY["policy"], **CELLS},
    "score": {"horizons": [5, 10]},
    "twin": {"fit": {"horizon": 10, "training_steps": 20, "evaluate_every": 10, "batch_size": 16, "stride": 4,
                     "hidden_layer_sizes": [8], "folds": 2, "replays": 4}},
}  # fmt: skip


def session(name: str, seed: int) -> Recording:
    """Of the kinematic model itself: its diagnosis is short."""
    rng, spot = np.random.default_rng(seed), Spot()
    move, phi = jax.jit(spot.step), np.mean(parameter_ranges(spot), axis=0)
    u = np.cumsum(rng.normal(0, 0.12, (24, 6)), axis=0).clip(-0.6, 0.6)
    states = [np.array([0, 0, 0, 0, 0, 0, 0.9, 0, 0.6, 0, 0, 0])]
    for command in u[:-1]:
        states.append(np.asarray(move(phi, states[-1], command)))
    return Recording(name, np.arange(24) / 15, np.array(states) + 0.002 * rng.normal(size=(24, 12)), u)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Params]:
    """A folder in which every stage up to the twin was run. Its folds are of one size, so they share compiled code."""
    root = tmp_path_factory.mktemp("recorded")
    for i, folder in enumerate(["driven"] * 2 + ["tests"] * 2 + ["axis"]):
        write_recording(root / "theirs" / folder, session(f"session_{i}", i), SCHEMA)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        params = load_params(ROOT / "params.yaml", OVERRIDES)
        for stage in (recordings, transitions, train, policy, twin):
            stage.run("mine", params, Path())
    return root, params


def test_further_sessions_are_for_the_twin_alone(done: tuple[Path, Params]) -> None:
    workspace = Workspace(done[0], "mine")
    files = [path for path in workspace.recordings.rglob("*") if path.is_file()]
    kept = Counter(path.relative_to(workspace.recordings).parts[0] for path in files)
    assert kept == {"training": 2, "test": 2, "further": 1}
    assert read_json(workspace.twin_record)["sessions"] == 5
    assert set(np.load(workspace.transitions / "training.npz")["session"]) == {0, 1}


def test_a_twin_is_scored_on_sessions_it_was_not_given(done: tuple[Path, Params]) -> None:
    workspace = Workspace(done[0], "mine")
    table = pd.read_csv(workspace.twin_report / "folds.csv")
    assert list(table.groupby("fold").model.apply(list)) == [[KNOWN, UNKNOWN, SIM_MODEL, BLACK_BOX]] * 2
    distances = table.filter(like="rollout_")
    assert {"rollout_ee_5", "rollout_ee_10", "rollout_base_10"} <= set(distances)
    assert (distances > 0).all(axis=None)
    assert table[table.model == UNKNOWN].coverage_ee_10.between(0, 1).all()
    text = (workspace.twin_report / "report.md").read_text()
    mean = table[table.model == UNKNOWN].rollout_ee_10.mean()
    assert f"After 10 rows the twin's hand is {mean:.2f} m from where it was measured" in text
    assert drawn(workspace.twin_report / "error_against_rows.png")
    metrics = read_json(workspace.twin_report / "metrics.json")
    assert metrics[UNKNOWN]["rollout_ee_10"] == pytest.approx(mean, rel=1e-5)  # the table has 6 digits


def test_policies_of_a_recorded_robot_run_on_its_twin(
    done: tuple[Path, Params], monkeypatch: pytest.MonkeyPatch
) -> None:
    root, params = done
    monkeypatch.chdir(root)
    rows = track.run("mine", params, Path())
    assert {row["policy"] for row in rows} > {"sim_model"}
    text = (Path("reports") / "mine" / "tracking" / "report.md").read_text()
    assert "The robot is the [twin](../twin/report.md) of the recorded one." in text
    # As many goals as the twin's rows take for the reference.
    kept = load_twin(Workspace(Path(), "mine").twin)
    goals = np.load("tracks/mine/proportional 1 per s.npz")["helix_goals"]
    wanted = params.track.helix.turns * params.track.helix.period / float(kept.row_s)
    assert len(goals) <= np.ceil(wanted) + 1


def test_a_twins_scores_are_in_mlflow(done: tuple[Path, Params]) -> None:
    client = MlflowClient(f"sqlite:///{done[0]}/mlflow.db")
    (experiment,) = [e for e in client.search_experiments() if e.name == twin.EXPERIMENT]
    run, *_ = client.search_runs([experiment.experiment_id])
    assert run.info.status == "FINISHED"
    assert run.data.metrics[f"{UNKNOWN}/rollout_ee_10"] > 0
    assert {"report.md", "folds.csv", "twin.npz"} <= {file.path for file in client.list_artifacts(run.info.run_id)}


def test_what_is_there_is_not_made_again(done: tuple[Path, Params], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a stage that was killed, what is finished stays; other parameters make it anew."""
    root, params = done
    monkeypatch.chdir(root)
    workspace = Workspace(Path(), "mine")
    times = {path: path.stat().st_mtime_ns for path in workspace.twins.glob("*")}
    assert len(times) == 2 * 3 + 2 + 2  # diagnoses, the twin, scores
    twin.run("mine", params, Path())
    assert {path: path.stat().st_mtime_ns for path in workspace.twins.glob("*")} == times


def test_a_robot_without_a_twin_is_named(tmp_path: Path, done: tuple[Path, Params]) -> None:
    root, params = done
    workspace = Workspace(tmp_path, "mine")
    workspace.policies.parent.mkdir(parents=True)
    (root / "policies" / "mine").rename(workspace.policies)
    try:
        with pytest.raises(SimgapError, match=r"twin\.npz"):
            track.run("mine", params, tmp_path)
    finally:
        workspace.policies.rename(root / "policies" / "mine")


def test_a_fold_without_a_long_session_is_named(done: tuple[Path, Params]) -> None:
    root, params = done
    workspace, short = Workspace(root, "mine"), [session(f"short_{i}", i) for i in range(2)]
    short = [r._replace(state=r.state[:9], command=r.command[:9], time_s=r.time_s[:9]) for r in short]
    context = tasks_twin.Context(params, "code", "diagnosis", lambda: 0.0, print)
    with pytest.raises(RecordingError, match=r"no session of fold 0 \(short_0\) has more than 12 rows"):
        tasks_twin.fold_scores.fn(workspace, TwinShare(0), tasks_twin.Recorded(short, []), context, lambda *_: None)


def test_a_virtual_robot_needs_no_twin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    twin.run("virtual", load_params(ROOT / "params.yaml"), tmp_path)
    assert "it needs no twin" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


def test_a_damaged_twin_says_which_stage_makes_it(tmp_path: Path) -> None:
    (tmp_path / "twin.npz").write_bytes(b"no archive")
    with pytest.raises(SimgapError, match=r"twin\.npz"):
        load_twin(tmp_path / "twin.npz")
    np.savez(tmp_path / "other.npz", kind="Actor")
    with pytest.raises(SimgapError, match=r"holds no twin of this version.*Run the stage `twin`"):
        load_twin(tmp_path / "other.npz")
