"""Statements of the layout before this one are read as if they were of this one."""

import json
from pathlib import Path
from typing import Any

import pytest

from simgap.diagnosis.report.schema import SCHEMA
from simgap.formats.statements import read, upgraded
from simgap.types import SimgapError


def effect(**more: Any) -> dict[str, Any]:
    return {"id": "delay", "constants": [{"name": "delay", "value": 0.1}], "from_s": None, "regime": None} | more


FIRST: dict[str, Any] = {
    "schema": 1, "simulator": "spot", "verdict": "missing_physics", "something_else": True, "left_over": {"nats": 3.0},
    "law": [], "effects": [effect(), effect(from_s=2.0), effect(regime="reach > 0.9 m")],
    "resembles": [effect(from_s=2.0, constants=[{"name": "to", "value": 5.0}])],
    "parameters": {"before": {"alpha": 0.1}, "after": {"alpha": 0.2}, "ci95": {}},
    "fit": {"models": {"as_is": {}, "refitted": {}}, "worse": [{"model": "refitted", "than": "as_is", "at": [50]}]},
    "sensitivity": {"chance": 0.9, "hidden_effects": ["lag"], "hidden_channels": []},
    "rounds": [{"accepted": None, "candidates": []}], "located": {"regimes": [{"when": "reach > 0.9 m", "share": 0.4}]},
    "replay": {"positions": [{"name": "elbow", "errors": {"as_is": 0.2, "refitted": 0.1}}]},
}  # fmt: skip


def test_every_part_has_its_new_name() -> None:
    found = upgraded(FIRST)
    assert found["schema"] == SCHEMA
    assert {"more_missing", "closest_matches", "whiteness", "nonparametric"} <= set(found)
    assert not {"something_else", "resembles", "left_over", "law"} & set(found)
    assert found["parameters"] == {"nominal": {"alpha": 0.1}, "fitted": {"alpha": 0.2}, "ci95": {}}
    assert list(found["fit"]["models"]) == ["nominal", "refitted"]
    assert found["fit"]["worse"] == [{"model": "refitted", "than": "nominal", "at": [50]}]
    assert found["sensitivity"] == {"power": 0.9, "undetectable_effects": ["lag"], "unexcited_channels": []}
    assert found["rounds"] == [{"accepted": None, "hypotheses": []}]
    assert found["located"]["regimes"] == [{"regime": "reach > 0.9 m", "share": 0.4}]
    assert found["replay"]["positions"][0]["errors"] == {"nominal": 0.2, "refitted": 0.1}


def test_a_time_and_a_regime_become_a_support() -> None:
    found = upgraded(FIRST)
    assert [e["support"]["kind"] for e in found["effects"]] == ["always", "from", "regime"]
    assert found["effects"][1]["support"]["from_s"] == 2.0
    assert found["effects"][2]["support"]["regime"] == "reach > 0.9 m"
    (match,) = found["closest_matches"]
    assert match["support"] == {"kind": "window", "session": None, "from_s": 2.0, "to_s": 5.0, "regime": None}
    assert not {"from_s", "regime"} & set(found["effects"][1])


def test_the_first_layout_is_not_changed_in_place() -> None:
    before = json.dumps(FIRST)
    upgraded(FIRST)
    assert json.dumps(FIRST) == before


def test_the_published_diagnoses_are_read() -> None:
    for robot in ("virtual", "spot"):
        found = read(Path("reports") / robot / "diagnosis" / "diagnosis.json")
        assert found["schema"] == SCHEMA
        assert {"nominal", "refitted"} <= set(found["fit"]["models"])


@pytest.mark.parametrize("schema", [3, None, "2"])
def test_another_layout_is_refused_by_its_number(tmp_path: Path, schema: object) -> None:
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps({"schema": schema}))
    with pytest.raises(
        SimgapError, match=f"diagnosis.json: `schema` is {schema}; this version of simgap reads 1 and 2"
    ):
        read(path)


@pytest.mark.parametrize(("share", "start"), [(1, {}), (0.02, {"kp pan": 0.02, "kp lift": 0.02})])
def test_one_share_of_all_servos_becomes_one_of_each(tmp_path: Path, share: float, start: dict[str, float]) -> None:
    values = {"kp pan": 60.0, "kp lift": 80.0, "damping pan": 3.0}
    old = {"schema": SCHEMA, "parameters": {"nominal": values}, "model_file": {"path": "arm.xml", "servo_share": share}}
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps(old))
    assert read(path)["model_file"] == {"path": "arm.xml", "start": start}
