"""The stage `external`: what is said of machines, against what their makers say."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from flows import external as flow
from simgap.types import ConfigError
from tasks import external, verdicts
from tasks.params_machines import ExternalCase, ExternalParams, load_external

ROOT = Path(__file__).parents[2]


def case(causes: list[list[str]], name: str = "ball") -> ExternalCase:
    return ExternalCase(name=name, simulator="examples.machines:BALL", recordings=["drops/*.csv"], causes=causes)


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
    ball, nowhere = verdicts.Runs(tmp_path / external.RUNS, "").every
    assert (external.place(tmp_path, params.cases[0]) / "diagnosis.html").is_file()
    assert ball["outcome"] in ("right", "open")  # 45 rows are few
    assert nowhere["outcome"] == "failed"
    assert "nowhere/*: there is no such recording" in nowhere["verdict"]

    monkeypatch.setattr(flow.fingerprint, "diagnosing_code", lambda **_: "another version")
    other = [{**ball, "code": "an older"}, {**ball, "code": "another "}]
    for row in other:
        verdicts.Runs(tmp_path / external.RUNS, row["code"]).keep(row)
    flow.run(params, tmp_path)
    assert "1 of 2 machines are diagnosed already" in capsys.readouterr().out
    assert [(row["code"], row["case"]) for row in verdicts.Runs(tmp_path / external.RUNS, "").every] == [
        (ball["code"], "ball"),
        (ball["code"], "lost"),
        ("an older", "ball"),
        ("another ", "ball"),
        ("another ", "lost"),
    ]


def test_what_forecasts_miss_is_kept_where_it_is_known() -> None:
    said = {"verdict": "nothing", "effects": [], "closest_matches": [],
            "fit": {"models": {"nominal": {"error_50": {"value": 0.2}}, "refitted": {}}}}  # fmt: skip
    row = external.row_of(case([]), said)
    assert row["outcome"] == "right"
    assert row["error_50_nominal"] == 0.2
    assert row["error_50_black_box"] is None


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
