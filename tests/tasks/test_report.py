"""Summaries, comparisons and claims on scores made up by hand."""

import math
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from PIL import Image

from simgap.formats.documents import read_json
from tasks import report, score
from tasks.workspace import Workspace


def row(model: str, n: int, seed: int, nll: float) -> dict[str, Any]:
    validation = math.nan if model == "sim_model" else nll
    return {"noise": "gaussian", "model": model, "sample_size": n, "seed": seed, "seconds": 1.0, "steps": 10,
            "nll": nll, "nll_median": nll, "validation_nll": validation, "calibration_error": 0.1, "rollout_ee_5": 0.1,
            "rollout_ee_10": 0.2, "rollout_base_5": 0.1, "rollout_base_10": 0.2}  # fmt: skip


def rows(nll: dict[tuple[str, int], tuple[float, ...]]) -> list[dict[str, Any]]:
    return [row(model, n, seed, value) for (model, n), values in nll.items() for seed, value in enumerate(values)]


PAPER = rows({
    ("sim_model", 1000): (-20.0, -20.1, -19.9), ("sim_model", 2000): (-20.0, -20.1, -19.9),
    ("fsvgd", 1000): (-15.0, -15.5, -14.5), ("fsvgd", 2000): (-20.0, -20.5, -20.6),
    ("sim_fsvgd", 1000): (-20.2, -19.9, -19.8), ("sim_fsvgd", 2000): (-22.0, -22.1, -22.5),
})  # fmt: skip


def test_summary_is_mean_and_spread_over_seeds() -> None:
    summary = {(r["model"], r["sample_size"]): r for r in report.summarise(PAPER)}
    assert summary["fsvgd", 1000]["nll"] == pytest.approx(-15.0)
    assert summary["fsvgd", 1000]["nll_std"] == pytest.approx(0.5)
    assert summary["fsvgd", 1000]["seeds"] == 3


def test_the_papers_claims_hold_where_they_do() -> None:
    answers = dict(report.claims(PAPER, "gaussian"))
    assert len(answers) == 3
    assert all("**holds**" in answer for answer in answers.values())


def test_a_claim_that_fails_is_said_to_fail() -> None:
    worse = [
        {**r, "nll": r["nll"] + 10} if r["model"] == "sim_fsvgd" and r["sample_size"] == 2000 else r for r in PAPER
    ]
    answers = dict(report.claims(worse, "gaussian"))
    assert "holds at 1 of 2 N" in answers["Sim-FSVGD below FSVGD at every N"]
    assert "does not hold" in answers["Sim-FSVGD below SIM-MODEL from N = 2000 on"]


def diagnosed() -> list[dict[str, Any]]:
    """The paper's scores with both diagnosed models, better by a nat each, and what was found."""
    found = {
        (1000, 0): "delay, lag",
        (1000, 1): "",
        (1000, 2): "",
        (2000, 0): "lag",
        (2000, 1): "lag",
        (2000, 2): "lag",
    }
    more = [
        {**r, "model": f"{r['model']}_diagnosed", "nll": r["nll"] - 1.0, "effects": found[r["sample_size"], r["seed"]]}
        for r in PAPER
        if r["model"] != "fsvgd"
    ]
    return [*PAPER, *more]


def test_what_the_diagnosis_adds_is_told(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path, "virtual")
    score.write(workspace, diagnosed())
    report.write(workspace, score.load(workspace), ["gaussian"], 60)
    text = (workspace.reports / "report.md").read_text()
    assert "- SIM-MODEL + diagnosed: **below at 2** of 2 N against SIM-MODEL (-1.00 ± 0.00 at N = 1000, -1.00" in text
    assert "- Sim-FSVGD + diagnosed: **below at 2** of 2 N against Sim-FSVGD" in text
    assert "- N = 1000: delay, lag (seed 0); none (seed 1, 2)\n- N = 2000: lag (seed 0, 1, 2)" in text
    assert "| SIM-MODEL + diagnosed | 1000 | -21.00 ± 0.10 |" in text
    assert "nan" not in text
    table = pd.read_csv(workspace.reports / "scores.csv", keep_default_na=False)
    assert set(table.loc[table["model"] == "sim_model_diagnosed", "effects"]) == {"delay, lag", "", "lag"}
    wide = pd.read_csv(workspace.reports / "nll.csv")
    assert "gaussian_sim_fsvgd_diagnosed" in wide.columns
    assert not wide.isna().any(axis=None)


def test_without_diagnosed_models_nothing_is_said_of_them() -> None:
    assert report.diagnosis_adds(PAPER, "gaussian") == []
    assert report.effects_found(PAPER) == []


def test_comparison_is_paired_by_seed_and_careful_with_one() -> None:
    (one,) = report.compare(rows({("a", 100): (1.0,), ("b", 100): (9.0,)}), "gaussian", "a", "b")
    assert one["verdict"] == "level"
    (pairs,) = report.compare(rows({("a", 100): (1.0, 5.0), ("b", 100): (2.0, 6.0)}), "gaussian", "a", "b")
    assert pairs["difference"] == -1.0
    assert pairs["standard_error"] == 0.0
    assert pairs["verdict"] == "below"


def test_report_writes_what_dvc_declares(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path, "virtual")
    score.write(workspace, PAPER)
    report.write(workspace, score.load(workspace), ["gaussian"], 60)
    names = {path.name for path in workspace.reports.iterdir()}
    assert names == {"report.md", "scores.csv", "summary.csv", "metrics.json", "nll.csv", "nll_against_n.png",
                     "rollouts_against_n.png"}  # fmt: skip
    assert Image.open(workspace.reports / "nll_against_n.png").mode == "P"  # a palette: git keeps them
    wide = pd.read_csv(workspace.reports / "nll.csv")
    assert wide.columns.tolist() == ["sample_size", "gaussian_fsvgd", "gaussian_sim_fsvgd", "gaussian_sim_model"]
    text = (workspace.reports / "report.md").read_text()
    assert "| SIM-MODEL | 1000 | -20.00 ± 0.10 |" in text
    assert "nan" not in text


def test_a_score_that_is_not_finite_stays_one_models_trouble(tmp_path: Path) -> None:
    """And `dvc metrics show` has a number a model: the mean NLL at the largest N, under the better noise."""
    workspace = Workspace(tmp_path, "virtual")
    both = [*PAPER, *({**r, "noise": "student_t", "nll": r["nll"] - 1.0} for r in PAPER if r["model"] == "sim_fsvgd")]
    score.write(workspace, [{**r, "nll": math.inf} if r["model"] == "fsvgd" else r for r in both])
    report.write(workspace, score.load(workspace), ["gaussian"], 60)
    metrics = read_json(workspace.reports / "metrics.json")
    assert metrics == {
        "nll_fsvgd": None,
        "nll_sim_fsvgd": pytest.approx(-23.2, abs=1e-6),
        "nll_sim_model": pytest.approx(-20.0, abs=1e-6),
    }
