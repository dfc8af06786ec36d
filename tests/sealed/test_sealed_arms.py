"""The sealed suite of arms at its smallest: concealed, diagnosed by the process that cannot open keys, scored."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from flows.sealed import conceal, examine, score
from simgap.formats.documents import read_json, write_json
from simgap.types import SimgapError
from tasks import fingerprint
from tasks.params_sealed import SealedParams, load_sealed
from tasks.sealed.examine import fingerprint as mark_of
from tasks.sealed.workspace import MODEL, SealedWorkspace

FILE = Path(__file__).parents[2] / "pipelines" / "sealed" / "params.yaml"
CAUSE = "friction at all joints"
TINY = {"nulls": 1, "repeats": 1, "causes": [CAUSE], "parts": 2, "sessions": 2, "rows": 60}


def params_with(**arm: Any) -> SealedParams:
    return load_sealed(FILE, {"conceal": {"arm": {**TINY, **arm}}, "examine": {"workers": 1, "patience_s": 7200.0}})


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> SealedWorkspace:
    """After `conceal`: a null and a case of friction."""
    workspace = SealedWorkspace(tmp_path_factory.mktemp("arms"), "arm")
    conceal.run.fn("arm", params_with(), workspace.root)
    return workspace


def test_a_case_is_a_model_and_recordings_of_which_no_name_tells(workspace: SealedWorkspace) -> None:
    manifest = read_json(workspace.published)
    assert [len(part) for part in manifest["parts"]] == [2]
    for name in manifest["keys"]:
        assert sorted(path.name for path in workspace.case(name).iterdir()) == ["a.csv", "b.csv", MODEL]
    everything = json.dumps(manifest) + "".join(p.read_text() for p in workspace.cases.rglob("*.*"))
    assert "friction" not in everything
    assert manifest["code"] == fingerprint.diagnosing_code(True) != fingerprint.diagnosing_code(False)


def test_another_model_is_another_case(workspace: SealedWorkspace) -> None:
    name = next(iter(read_json(workspace.manifest)["keys"]))
    model, before = workspace.case(name) / MODEL, mark_of(workspace, name, 0, "code")
    text = model.read_text()
    model.write_text(text.replace('kp="', 'kp="1'))
    try:
        assert mark_of(workspace, name, 0, "code") != before
    finally:
        model.write_text(text)
    assert mark_of(workspace, name, 0, "code") == before


def statement(replay: dict[str, float], **more: Any) -> dict[str, Any]:
    """What a diagnosis might have said."""
    return {
        "schema": 2, "verdict": "nothing", "effects": [], "located": {"regimes": []},
        "fit": {"models": {}, "heldout_sessions": ["b"]},
        "parameters": {"nominal": {"kp base": 60.0}, "fitted": {"kp base": 70.0}},
        "replay": {"positions": [{"name": "base_pos", "errors": replay}]},
        **more,
    }  # fmt: skip


@pytest.mark.long
def test_scores_of_a_suite_of_arms(workspace: SealedWorkspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """Statements made up: the null is quiet, the friction is named, with a constant that is 2 % off."""
    monkeypatch.chdir(workspace.root)
    keys = score.score.open_keys.fn
    manifest = read_json(workspace.manifest)
    for name in manifest["keys"]:
        write_json(workspace.record(name), {"fingerprint": f"0123-{name}", "seconds": 9.0, "error": None})
        write_json(workspace.statement(name), statement({"nominal": 1e-3, "refitted": 1e-3}))
    for name, key in keys(workspace).keys.items():
        if key["kind"] == "single":
            loss = key["effects"][0]["constants"][0]["value"]
            named = {"id": "coulomb_friction", "probability": 0.99, "credible_set": ["coulomb_friction"], "outputs": [],
                     "channels": ["cmd_base"], "gain_nats": 99.0,
                     "constants": [{"name": "loss", "unit": "N m", "value": 1.02 * loss,
                                    "ci95": [1.01 * loss, 1.03 * loss]}]}  # fmt: skip
            errors = {"nominal": 1e-2, "refitted": 9e-3, "augmented": key["floor"]}
            write_json(workspace.statement(name), statement(errors, verdict="missing_physics", effects=[named]))
    score.run("arm", params_with(), workspace.root)
    (report,) = workspace.reports.iterdir()
    text = (report / "report.md").read_text()
    assert "## Failures: 0 of 2 cases" in text
    assert f"| single | {CAUSE} |" in text
    for line in ("false alarms on nulls | 0 | 0 to 0.793 | 1 |", "no other, 30 nats and more | 1 | 0.207 to 1 | 1 |",
                 "coverage of 95 % intervals | 0 |", "within 5 %, or in their interval | 1 |",
                 "in noise, median | 1 |"):  # fmt: skip
        assert line in text
    assert read_json(workspace.metrics) == {"false_alarms": 0.0, "right_name": 1.0, "sure_wrong": 0.0}
    assert "| mujoco.sysid, all parameters |" in text
    kept = [workspace.examination(name) / score.score.SYSID for name in manifest["keys"]]
    before = [path.read_text() for path in kept]
    assert all(row["moved"] == 1 and row["sysid_open_loop"] > 0 for row in stage_rows(workspace))
    assert [path.read_text() for path in kept] == before, "the toolbox fitted a case again"


def test_an_unknown_cause_and_an_empty_suite_are_refused(tmp_path: Path) -> None:
    for arm, words in (({"causes": ["rust"]}, "no arm has rust; there are friction at a joint,"),
                       ({"nulls": 0, "repeats": 0}, "there must be a case")):  # fmt: skip
        with pytest.raises(SimgapError, match=words):
            conceal.run.fn("arm", params_with(**arm), tmp_path)
    assert not (tmp_path / "data" / "sealed" / "arm" / "manifest.json").exists()


def test_the_part_that_is_run_first_is_a_sample_of_the_whole() -> None:
    whole = yaml.safe_load(FILE.read_text())["conceal"]["arm"]
    assert whole["nulls"] == 2 * whole["parts"]
    assert whole["repeats"] == whole["parts"]


@pytest.mark.long
def test_a_case_is_diagnosed_by_its_own_model(tmp_path: Path) -> None:
    """The one real diagnosis: by a process that is locked away from the keys, of a user's model and recordings."""
    workspace, params = SealedWorkspace(tmp_path, "arm"), params_with(nulls=0, sessions=4, rows=100)
    conceal.run.fn("arm", params, tmp_path)
    examine.run("arm", params, tmp_path)
    (name,) = read_json(workspace.manifest)["keys"]
    result = read_json(workspace.statement(name))
    (row,) = stage_rows(workspace)
    assert result["simulator"].endswith(MODEL)
    assert result["parameters"]["units"]["kp base"] == "N m/rad"
    assert {p["name"] for p in result["replay"]["positions"]} == {"base_pos", "shoulder_pos", "elbow_pos"}
    assert row["error"] is None
    assert row["open_loop"] < row["open_loop_nominal"]


def stage_rows(workspace: SealedWorkspace) -> list[dict[str, Any]]:
    opened = score.score.open_keys.fn(workspace)
    return score.score.rows.fn(workspace, opened, lambda *_: None)
