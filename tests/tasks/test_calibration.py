"""The regression behind the probability of a name, fitted to the table of the training ground."""

from pathlib import Path

import numpy as np
import pytest
from drawn import drawn

from simgap.diagnosis.validation.calibration import INTERCEPT, RANGES, WEIGHTS
from simgap.diagnosis.validation.indicators import Indicators
from simgap.diagnosis.validation.mistaken import PER_HUNDRED, USUAL
from simgap.effects import CATALOGUE
from simgap.formats.documents import read_json
from tasks.calibration import FIT, LEAST, PICTURE, PRIOR, Found, calibrate
from tasks.ground import MEASURED

ROOT = Path(__file__).parents[2]
FAMILIES = ("friction", "delay", "cogging", "gusts")
EFFECTS = ("delay", "lag", "gain")


def row(
    case: int, families: str, right: list[int], indicators: list[Indicators], code: str = "a", effect: str = "delay"
) -> dict[str, str]:
    columns = {name: "; ".join(str(getattr(i, name)) for i in indicators) for name in MEASURED}
    found = {"found": "; ".join(effect for _ in indicators), "right": "; ".join(map(str, right))}
    of = {"code": code, "case": str(case), "machine": "base", "outcome": "part", "families": families}
    return {**of, **found, **columns}


def drawn_rows(n: int, seed: int = 0) -> list[dict[str, str]]:
    """Effects whose names are right by a known law: the more a law bends, the less. All are mistaken as often."""
    rng = np.random.default_rng(seed)
    rows = []
    for case in range(n):
        found = [Indicators(**{k: rng.uniform(*ends) for k, ends in RANGES.items()}) for _ in range(2)]
        right = [int(rng.random() < 1 / (1 + np.exp(6 * i.bending - 3))) for i in found]
        rows.append(row(case, FAMILIES[case % 4], right, found, effect=EFFECTS[case % 3]))
    return rows


def test_a_known_law_is_found_again(tmp_path: Path) -> None:
    calibrate(drawn_rows(1500), tmp_path)
    fit = read_json(tmp_path / FIT)
    assert fit["effects"] == 3000
    weights = fit["weights"]
    assert fit["intercept"] == pytest.approx(0, abs=0.35)
    assert weights.pop("bending") == pytest.approx(-3, rel=0.15)
    assert max(map(abs, weights.values())) < 0.4
    assert fit["calibration_error"] < 0.04
    assert fit["log_loss_of_families_held_out"] < fit["log_loss_of_the_share_alone"] - 0.1
    for b in fit["bins"]:
        assert b["right"] == pytest.approx(b["stated"], abs=4 * np.sqrt(b["stated"] * (1 - b["stated"]) / b["effects"]))
    assert drawn(tmp_path / PICTURE)


def test_with_few_effects_nothing_is_fitted(tmp_path: Path) -> None:
    assert f"at least {LEAST}" in calibrate(drawn_rows(LEAST // 2 - 1), tmp_path)
    assert not (tmp_path / FIT).exists()


def test_of_several_versions_of_a_case_the_last_counts_and_a_case_without_effects_has_none() -> None:
    end = Indicators(**{name: high for name, (_, high) in RANGES.items()})
    rows = [row(0, "delay", [1, 1], [end, end]), row(1, "", [], []), row(0, "delay; gusts", [0], [end], "b")]
    found = Found.of(rows)
    assert found.families == [("delay", "gusts"), ("nothing",)]
    assert found.right.tolist() == [False]
    assert found.case.tolist() == [0]
    assert [part.tolist() for part in found.of_families()] == [[True, False], [True, False], [False, True]]


def test_wrong_findings_are_counted_where_they_were_possible_and_known() -> None:
    """Of machines that may have the effect, from the draw on that found it first; few are drawn to the usual rate."""
    end = Indicators(**{name: high for name, (_, high) in RANGES.items()})
    rows = [row(n, "delay", [n % 2], [end]) for n in range(40)]  # 20 wrong delays
    rows += [row(n, "delay", [0], [end], effect="lag") for n in range(2000, 2010)]  # 10 wrong lags, in the last draw
    rows += [row(n, "", [], []) | {"machine": "servo"} for n in range(3000, 3050)]
    found = Found.of(rows)
    rates, usual = found.mistaken(np.ones(len(rows), bool))
    expected = lambda wrong, of, usual: 100 * (wrong + PRIOR) / (of + 100 * PRIOR / usual)  # noqa: E731
    assert usual == pytest.approx(100 * 31 / (100 + 60 + 1))
    assert rates == pytest.approx({"delay": expected(20, 100, usual), "lag": expected(10, 60, usual)})
    before, usual = found.mistaken(np.arange(len(rows)) < 40)
    assert before == pytest.approx({"delay": expected(20, 40, usual), "lag": usual})


def test_the_code_has_the_weights_that_were_fitted() -> None:
    fit = read_json(ROOT / FIT)
    assert pytest.approx(fit["intercept"], abs=0.05) == INTERCEPT
    assert {" x ".join(names): w for names, w in WEIGHTS.items()} == pytest.approx(fit["weights"], abs=0.05)
    assert pytest.approx(fit["mistaken_per_hundred"], rel=0.1) == PER_HUNDRED
    assert pytest.approx(fit["usually_mistaken"], rel=0.1) == USUAL
    assert set(PER_HUNDRED) <= {effect.id for effect in CATALOGUE}
