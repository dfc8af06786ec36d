"""Ties of an examined suite: the robot of a case is run again in the experiment that its diagnosis prescribed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from concealed import sessions
from concealed.experiment import STILL, experiment
from flows.sealed import conceal, examine
from flows.sealed.examiner import recordings_of
from simgap.formats.documents import read_json, write_json, write_text
from simgap.types import SimgapError
from tasks.params_sealed import SealedParams, load_sealed
from tasks.sealed import score
from tasks.sealed.judge import judge
from tasks.sealed.keys import opened
from tasks.sealed.ties import tied_names
from tasks.sealed.workspace import PRESCRIBED, RECORDED, SealedWorkspace

ROOT = Path(__file__).parents[2]
TINY = {"conceal": {"nulls": 0, "effects": ["delay"], "ties": {"repeats": 3}}}
COMMANDS = np.zeros((60, 6))
COMMANDS[20:40, 0] = 0.5  # forwards [m/s]


@pytest.fixture(scope="module")
def params() -> SealedParams:
    small = yaml.safe_load((ROOT / "pipelines" / "sealed" / "small.yaml").read_text())
    return load_sealed(ROOT / "pipelines" / "sealed" / "params.yaml", small, TINY)


def statement(*names: str) -> dict[str, Any]:
    effect = {"id": names[0], "credible_set": list(names), "gain_nats": 50.0, "probability": 0.5, "outputs": [],
              "channels": [], "constants": [], "support": {"from_s": None}}  # fmt: skip
    return {"schema": 2, "verdict": "missing_physics", "effects": [effect], "fit": {"models": {}}, "located": {}}


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory, params: SealedParams) -> SealedWorkspace:
    """A suite of a delay, of which it was said that it may be a lag."""
    workspace = SealedWorkspace(tmp_path_factory.mktemp("ties"), "development")
    conceal.run.fn("development", params, workspace.root)
    (case,) = opened(workspace)[1]
    write_json(workspace.statement(case), statement("lag", "delay"))
    rows = [[k / 15, *row] for k, row in enumerate(COMMANDS.tolist())]
    header = ",".join(("time_s", *sessions.SPOT.command))
    write_text(workspace.experiment(case), "\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return workspace


@pytest.fixture(scope="module")
def workspace(other: SealedWorkspace, params: SealedParams) -> SealedWorkspace:
    conceal.run.fn("ties", params, other.root)
    return SealedWorkspace(other.root, "ties")


def test_a_tie_has_what_was_recorded_and_the_experiment(other: SealedWorkspace, workspace: SealedWorkspace) -> None:
    ((case, key),) = opened(workspace)[1].items()
    ((before, its_key),) = opened(other)[1].items()
    assert key == {**its_key, "tied": ["lag", "delay"]}
    assert recordings_of(workspace.case(case)) == [workspace.case(case) / name for name in (RECORDED, PRESCRIBED)]
    for again, first in zip(sessions.read(workspace.recordings(case)), sessions.read(other.case(before)), strict=True):
        np.testing.assert_array_equal(again, first)
    measured, command = sessions.read(workspace.case(case) / PRESCRIBED)
    assert measured.shape == (3, STILL + 60, 12)
    np.testing.assert_allclose(command[:, STILL:], np.stack([COMMANDS] * 3), atol=1e-6)
    assert not command[:, :STILL].any()
    assert len({x.tobytes() for x in measured}) == 3, "from different places, with different noise"
    assert recordings_of(other.case(before)) == [other.case(before)], "where nothing was prescribed, the case itself"


@pytest.mark.long
def test_a_tie_is_diagnosed_with_both_and_scored(workspace: SealedWorkspace, params: SealedParams) -> None:
    examine.run("ties", params, workspace.root)
    (case,) = opened(workspace)[1]
    assert read_json(workspace.record(case))["error"] is None
    found = read_json(workspace.statement(case))
    assert len(found["recordings"]["training_sessions"]) + len(found["recordings"]["heldout_sessions"]) == 4 + 3
    (row,) = score.rows.fn(workspace, score.open_keys.fn(workspace), lambda *_: None)
    only_delay = row["answer"] == "delay" and found["effects"][0]["credible_set"] == ["delay"]
    assert row["settled"] == only_delay


def test_the_robot_of_the_experiment_has_the_effect_of_the_case(other: SealedWorkspace) -> None:
    """A delay: the same runs without it move earlier."""
    (key,) = opened(other)[1].values()
    none = {**key, "effects": [{**effect, "magnitude": 0.0} for effect in key["effects"]]}
    late, prompt = (experiment(k, COMMANDS, 4, 7)[0] for k in (key, none))
    speed = lambda x: np.hypot(x[:, :, 3], x[:, :, 4]).mean(0)  # noqa: E731
    begins = STILL + 20
    assert speed(late)[begins + 1] < 0.7 * speed(prompt)[begins + 1]
    np.testing.assert_array_equal(late[:, :begins], prompt[:, :begins])
    np.testing.assert_array_equal(experiment(key, COMMANDS, 4, 7)[0], late)


def test_what_is_no_tie_is_not_repeated(other: SealedWorkspace, params: SealedParams) -> None:
    (key,) = opened(other)[1].values()
    assert tied_names(key, statement("lag", "delay")) == ["lag", "delay"]
    assert tied_names(key, statement("delay")) == []
    assert tied_names(key, statement("lag", "gain")) == [], "the right name is not among them: it is wrong, not tied"
    (case,) = opened(other)[1]
    before = read_json(other.statement(case))
    write_json(other.statement(case), statement("delay"))
    with pytest.raises(SimgapError, match="no examined case is a tie"):
        conceal.run.fn("ties", params, other.root)
    write_json(other.statement(case), before)


@pytest.mark.parametrize(
    ("names", "settled"), [(("delay",), True), (("lag", "delay"), False), (("lag",), False), (("gain",), False)]
)
def test_a_tie_is_settled_where_only_the_right_name_is_left(
    other: SealedWorkspace, names: tuple[str, ...], settled: bool
) -> None:
    (key,) = opened(other)[1].values()
    row = judge({**key, "tied": ["lag", "delay"]}, statement(*names), 1.0, None)
    assert row["settled"] is settled
    assert "settled" not in judge(key, statement(*names), 1.0, None)
