"""The sealed suite of machines of five kinds at its smallest: concealed, diagnosed by their simulators, scored."""

import json
from pathlib import Path

import pytest

from concealed.kinds.case import Recipe, conceal
from flows.sealed import conceal as conceal_flow
from flows.sealed import examine, score
from simgap.formats.documents import read_json
from tasks.params_sealed import SealedParams, load_sealed
from tasks.sealed.examine import fingerprint
from tasks.sealed.judge import judge
from tasks.sealed.workspace import SIMULATOR, SealedWorkspace

FILE = Path(__file__).parents[2] / "pipelines" / "sealed" / "params.yaml"
TINY = {"nulls": 1, "repeats": 0, "parts": 5, "sessions": 3, "rows": 60}


def params() -> SealedParams:
    return load_sealed(FILE, {"conceal": {"kinds": TINY}, "examine": {"workers": 1, "parts": [4]}})


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> SealedWorkspace:
    """After `conceal`: a null of every kind."""
    workspace = SealedWorkspace(tmp_path_factory.mktemp("kinds"), "kinds")
    conceal_flow.run.fn("kinds", params(), workspace.root)
    return workspace


def test_a_case_is_recordings_and_the_name_of_a_simulator(workspace: SealedWorkspace) -> None:
    manifest = read_json(workspace.published)
    assert [len(part) for part in manifest["parts"]] == [1] * 5
    named = set()
    for name in manifest["keys"]:
        assert sorted(path.name for path in workspace.case(name).iterdir()) == ["a.csv", "b.csv", "c.csv", SIMULATOR]
        named.add((workspace.case(name) / SIMULATOR).read_text())
    assert len(named) == 5


def test_another_simulator_is_another_case(workspace: SealedWorkspace) -> None:
    name = next(iter(read_json(workspace.manifest)["keys"]))
    path, before = workspace.case(name) / SIMULATOR, fingerprint(workspace, name, 0, "code")
    text = path.read_text()
    path.write_text("examples.drive:DRIVE")
    try:
        assert fingerprint(workspace, name, 0, "code") != before
    finally:
        path.write_text(text)
    assert fingerprint(workspace, name, 0, "code") == before


@pytest.mark.long
def test_a_machine_is_diagnosed_with_its_own_simulator_and_scored(
    workspace: SealedWorkspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(workspace.root)
    examine.run.fn("kinds", params(), workspace.root)
    (case,) = read_json(workspace.manifest)["parts"][4]
    statement = read_json(workspace.statement(case))
    assert statement["simulator"] == (workspace.case(case) / SIMULATOR).read_text()
    score.run.fn("kinds", params(), workspace.root)
    report = next(workspace.reports.glob("*/report.md")).read_text()
    assert "cases: 1 of 5" in report
    assert "pysindy" not in report
    assert json.loads(workspace.metrics.read_text())


def test_only_a_right_name_scores() -> None:
    """Of a made-up statement about a boat whose motors lag behind."""
    key = conceal(Recipe("boat", "lag of a boat"), 2, 40, 0).key
    named = {"id": "lag", "probability": 0.9, "credible_set": ["lag"], "outputs": [], "channels": ["thrust"],
             "gain_nats": 90.0, "constants": [{**key["effects"][0]["constants"][0], "ci95": [0.0, 9.0]}],
             "support": {}}  # fmt: skip
    said = {"verdict": "missing_physics", "effects": [named], "fit": {"models": {}}, "located": {"regimes": []}}
    assert judge(key, said, 1.0, None)["top1"]
    assert judge(key, said, 1.0, None)["constant_error"] == 0.0
    surely = {**named, "id": "delay", "credible_set": ["delay"], "probability": 0.99}
    wrong = judge(key, {**said, "effects": [surely]}, 1.0, None)
    assert not wrong["top1"]
    assert wrong["confident_wrong"]
