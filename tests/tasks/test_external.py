"""The stage `external`: what is said of machines, against what their makers say."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from flows import external as flow
from simgap.types import ConfigError
from tasks import external
from tasks.params import ExternalCase, ExternalParams, load_external

ROOT = Path(__file__).parents[2]


def case(causes: list[list[str]], name: str = "ball") -> ExternalCase:
    return ExternalCase(name=name, simulator="examples.machines:BALL", recordings=["drops/*.csv"], causes=causes)


def statement(verdict: str, *named: tuple[str, float], ties: tuple[str, ...] = ()) -> dict[str, Any]:
    effects = [{"id": name, "probability": p, "credible_set": [name, *ties]} for name, p in named]
    models = {"as_is": {"error_50": {"value": 0.2}}, "refitted": {}}
    return {"verdict": verdict, "effects": effects, "resembles": [], "fit": {"models": models}}


@pytest.mark.parametrize(
    ("causes", "said", "outcome"),
    [
        ([["drag"]], statement("missing_physics", ("drag", 0.9)), "right"),
        ([["drag", "friction"]], statement("missing_physics", ("friction", 0.9)), "right"),
        ([["drag"], ["delay"]], statement("missing_physics", ("delay", 0.9)), "part"),
        ([["drag"]], statement("missing_physics", ("drag", 0.9), ("gain", 0.8)), "surplus"),
        ([["drag"]], statement("missing_physics", ("gain", 0.5), ties=("drag",)), "tied"),
        ([["drag"]], statement("missing_physics", ("gain", 0.99)), "wrong"),
        ([["drag"]], statement("nothing"), "wrong"),
        ([["drag"]], statement("unexplained"), "open"),
        ([["drag"]], statement("inconclusive"), "open"),
        ([], statement("nothing"), "right"),
        ([], statement("parameters_only"), "right"),
        ([], statement("missing_physics", ("gain", 0.99)), "wrong"),
        ([], statement("inconclusive"), "open"),
    ],
)
def test_an_outcome_is_what_the_key_makes_of_the_statement(
    causes: list[list[str]], said: dict[str, Any], outcome: str
) -> None:
    row = external.judged(case(causes), said)
    assert row["outcome"] == outcome
    assert row["error_50_as_is"] == 0.2
    assert row["error_50_black_box"] is None


def test_the_probability_of_a_wrong_name_is_kept() -> None:
    row = external.judged(case([["drag"]]), statement("missing_physics", ("drag", 1.0), ("gain", 0.97)))
    assert row["sure"] == 0.97
    assert external.summary([row, external.failed("lost")])[-1] == (
        "1 of 2 have a name that is wrong with a probability of 0.95 or more"
    )


def test_every_run_is_kept_and_a_finished_one_is_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "drops").mkdir()
    time_s, rng = np.arange(45) / 15, np.random.default_rng(0)
    for drop in range(2):
        height = 47 - 9.81 * time_s**2 / 2 + rng.normal(0.0, 0.02, 45)
        pd.DataFrame({"time_s": time_s, "height": height}).to_csv(tmp_path / "drops" / f"{drop}.csv", index=False)
    lost = ExternalCase(name="lost", simulator="examples.machines:BALL", recordings=["nowhere/*"], causes=[])
    params = ExternalParams(seed=0, folder=tmp_path, cases=[case([]), lost])
    flow.run(params, tmp_path)
    ball, nowhere = external.earlier(tmp_path)
    assert (external.place(tmp_path, params.cases[0]) / "diagnosis.html").is_file()
    assert ball["outcome"] in ("right", "open")  # 45 rows are few
    assert nowhere["outcome"] == "failed"
    assert "nowhere/*: there is no such recording" in nowhere["verdict"]

    monkeypatch.setattr(flow.fingerprint, "diagnosing_code", lambda **_: "another version")
    other = [{**ball, "code": "an older"}, {**ball, "code": "another "}]
    for row in other:
        external.keep(tmp_path, row)
    flow.run(params, tmp_path)
    assert "1 of 2 machines are diagnosed already" in capsys.readouterr().out
    assert [(row["code"], row["case"]) for row in external.earlier(tmp_path)] == [
        (ball["code"], "ball"),
        (ball["code"], "lost"),
        ("an older", "ball"),
        ("another ", "ball"),
        ("another ", "lost"),
    ]


def test_the_machines_of_the_file_can_be_simulated() -> None:
    """Each of them by its name, if it is one of the project's own."""
    params = load_external(ROOT / "pipelines" / "external" / "params.yaml")
    from simgap.loading.load import load

    for each in {c.simulator for c in params.cases if ":" in c.simulator}:
        simulator = load(each)
        nominal = np.array([p.nominal for p in simulator.parameters])
        sizes = len(simulator.schema.state), len(simulator.schema.command)
        assert np.isfinite(simulator.step(nominal, *(np.full(n, 0.1) for n in sizes))).all()


def test_an_override_that_is_no_case_is_named() -> None:
    with pytest.raises(ConfigError, match=r"cases.*causes"):
        load_external(ROOT / "pipelines" / "external" / "params.yaml", {"cases": [{"name": "x", "simulator": "y:Z"}]})
