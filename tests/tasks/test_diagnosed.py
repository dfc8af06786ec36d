"""Shares of the recordings, what is found in them, and cells that are given it."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from given import TRAINING_SIZES

from simgap.diagnosis.likelihood.scales import measure
from simgap.effects import CATALOGUE
from simgap.effects.augmented import Augmented
from simgap.effects.regime import everywhere
from simgap.formats.documents import read_json, write_json
from simgap.formats.recordings import write_recording
from simgap.models import BNN, FittedSimulator
from simgap.recordings import HISTORY
from simgap.residual.model import ResidualModel
from simgap.simulators import sample_parameters
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.spot import SCHEMA, Spot
from simgap.types import ConfigError, Recording
from tasks import diagnosed, score, train, transitions
from tasks.diagnosed import sessions
from tasks.files.models import save_model
from tasks.params import load_params
from tasks.workspace import Cell, Share, Workspace

STEP = 1 / 15
SPOT = Spot(time_step=STEP)
PARAMS = load_params(
    Path(__file__).parents[2] / "params.yaml",
    {"train": {**TRAINING_SIZES, "sim_fsvgd": {"function_samples": 8}},
     "score": {"horizons": [5], "stride": 20}},
)  # fmt: skip


def late(recordings: list[Recording], rows: float = 1.0) -> AugmentedSimulator:
    """The Spot with a dead time."""
    augmented = Augmented(SPOT)
    theta = np.array([rows if CATALOGUE[slot.effect].id == "delay" else 0.0 for slot in augmented.slots])
    return AugmentedSimulator.of(SPOT, everywhere(theta), measure(augmented, recordings))


def session(name: str, rows: int, seed: int) -> Recording:
    """A Spot that follows the commands of the row before."""
    (phi,) = sample_parameters(SPOT, jax.random.key(0), 1)
    rng = np.random.default_rng(seed)
    commands = np.repeat(rng.uniform(-0.5, 0.5, (rows // 5 + 1, 6)), 5, axis=0)[:rows]
    move, states = jax.jit(SPOT.step), [np.zeros(12)]
    for u in [np.zeros(6), *commands[:-2]]:
        states.append(np.asarray(move(phi, states[-1], u)))
    states = np.array(states) + 0.002 * rng.normal(size=(rows, 12))
    return Recording(name, np.arange(rows) * STEP, np.asarray(states), commands)


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    return [session(f"s{i}", 60 + i, i) for i in range(4)]


@pytest.fixture
def workspace(recordings: list[Recording], tmp_path: Path) -> Workspace:
    workspace = Workspace(tmp_path, "virtual")
    for split, some in (("training", recordings[:3]), ("test", recordings[3:])):
        for recording in some:
            write_recording(workspace.recordings / split, recording, SCHEMA)
        transitions.prepare.fn(workspace, split, STEP)
    return workspace


@pytest.fixture
def asked(recordings: list[Recording], monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """In place of a diagnosis, which takes a minute, a dead time is found; gives the seeds of those that were made."""
    made: list[int] = []

    def explain(simulator, used, _rng, report) -> SimpleNamespace:
        made.append(len(used.training) + len(used.heldout))
        assert simulator == SPOT
        assert not used.baseline
        report("looking")
        found = late(recordings)
        return SimpleNamespace(
            fit=None,
            acting=lambda _: found.acting,
            problem=SimpleNamespace(scales=found.scales),
            members=[SimpleNamespace(hypothesis=SimpleNamespace(name="delay on all"))],
            noise_effects=[SimpleNamespace(id="dropout")],
        )

    monkeypatch.setattr("simgap.diagnosis.inference.explain.explain", explain)
    return made


def find(workspace: Workspace, share: Share, code: str = "c") -> None:
    diagnosed.find.fn(workspace, share, STEP, code, lambda _: None, lambda: 0.0)


@pytest.mark.parametrize("count", [20, 57, 100, 174])
def test_a_share_has_its_number_of_transitions(recordings: list[Recording], count: int) -> None:
    used = sessions(recordings[:3], Share(count, 0))
    fitted, judging = (sum(len(r.time_s) - 1 - HISTORY for r in part) for part in (used.training, used.heldout))
    assert fitted == round(0.75 * count)
    assert count - fitted - HISTORY - 1 <= judging <= count - fitted


def test_the_seed_says_which_sessions_a_share_has(recordings: list[Recording]) -> None:
    starts = {seed: sessions(recordings, Share(60, seed)).training[0].name for seed in range(12)}
    assert len(set(starts.values())) > 1
    again = sessions(recordings, Share(60, 3)).training[0]
    assert again.name == starts[3]


def test_a_share_beyond_the_recordings_is_named(recordings: list[Recording]) -> None:
    with pytest.raises(ConfigError, match="N = 1000 transitions are asked for and the training sessions have 234"):
        sessions(recordings, Share(1000, 0))


def test_a_diagnosis_is_made_once(workspace: Workspace, asked: list[int], recordings: list[Recording]) -> None:
    share = Share(80, 0)
    find(workspace, share)
    find(workspace, share)
    assert len(asked) == 1
    found = diagnosed.load(workspace, share)
    assert found.simulator == late(recordings)
    record = read_json(workspace.effects(share))
    assert (record["effects"], record["found"], record["scattered"]) == (["delay"], ["delay on all"], ["dropout"])

    find(workspace, share, "other code")
    find(workspace, share._replace(seed=1), "other code")
    assert len(asked) == 3
    assert diagnosed.load(workspace, share).fingerprint != found.fingerprint


def test_a_diagnosis_that_fails_leaves_no_other_in_its_place(
    workspace: Workspace, asked: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    share = Share(80, 0)
    find(workspace, share)

    def fail(*_: object) -> None:
        raise ConfigError("no")

    monkeypatch.setattr("simgap.diagnosis.inference.explain.explain", fail)
    with pytest.raises(ConfigError):
        find(workspace, share, "other code")
    assert not workspace.effects(share).exists()
    assert len(asked) == 1


@pytest.mark.long
@pytest.mark.parametrize("model", ["sim_model_diagnosed", "sim_fsvgd_diagnosed", "residual_diagnosed"])
@pytest.mark.usefixtures("asked")
def test_a_diagnosed_cell_is_trained_and_scored(workspace: Workspace, recordings: list[Recording], model: str) -> None:
    cell = Cell("student_t", model, 80, 0)
    assert cell.share is not None
    assert diagnosed.shares([cell, cell._replace(noise="gaussian"), cell._replace(model="fsvgd")]) == [cell.share]
    find(workspace, cell.share)
    found = diagnosed.load(workspace, cell.share)
    shutil.rmtree(workspace.recordings / "test")  # training, choices included, has no use for test sessions
    seen = diagnosed.seen(workspace, cell.share, STEP)
    assert sum(len(r.time_s) - 1 - HISTORY for r in seen) == pytest.approx(80, abs=HISTORY + 1)
    rows = transitions.load(workspace, "training")
    fitted = train.fit(cell, rows, found.simulator, PARAMS.train, lambda *_: None, seen)
    write_recording(workspace.recordings / "test", recordings[3], SCHEMA)
    save_model(workspace.model(cell), fitted)
    write_json(workspace.record(cell), {"seconds": 1.0, "steps": 2, "curve": {}, "effects": ["delay"]})
    row = score.score_cell.fn(workspace, cell, score.load_test.fn(workspace, STEP), PARAMS.score)
    assert row["effects"] == "delay"
    assert np.isfinite([row["nll"], row["rollout_ee_5"]]).all()
    kinds = {"sim_model_diagnosed": FittedSimulator, "sim_fsvgd_diagnosed": BNN, "residual_diagnosed": ResidualModel}
    assert type(fitted) is kinds[model]


@pytest.mark.long
def test_where_nothing_is_found_the_model_is_its_twin(workspace: Workspace, recordings: list[Recording]) -> None:
    rows, nothing = transitions.load(workspace, "training"), late(recordings, 0.0)
    for twin in ("sim_model", "sim_fsvgd"):
        cell = Cell("student_t", twin, 80, 0)
        models = [train.fit(cell, rows, simulator, PARAMS.train, lambda *_: None) for simulator in (SPOT, nothing)]
        predictions = [score.scores.one_step(m, rows, SCHEMA.encoded) for m in models]
        assert predictions[0] == pytest.approx(predictions[1], rel=1e-4)
