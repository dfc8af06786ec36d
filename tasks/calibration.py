"""The probability that the cause is among the names of an effect, fitted to the table of the training ground.

A logistic regression on the indicators of every effect found. It is judged on families of causes that are held out.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import log_loss
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from simgap.diagnosis.validation.calibration import within
from simgap.diagnosis.validation.indicators import Indicators
from simgap.formats.documents import write_json
from tasks import plots
from tasks.verdicts import SEPARATOR

FIT = Path("reports/ground/calibration.json")
PICTURE = Path("reports/ground/calibration.png")
LEAST = 100
"""Effects found: with fewer there is nothing to fit."""
PENALTIES = (0.01, 0.1, 1.0, 10.0)
"""Inverse strengths of the ridge penalty on standardised indicators; the held-out families choose one."""
EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.0)
"""Of the bins in which stated and observed shares are compared."""
NOTHING = "nothing"


class Found(NamedTuple):
    """Effects found on the ground. families: of their cases' causes. right: whether a cause is among their names."""

    families: list[tuple[str, ...]]
    indicators: Float[np.ndarray, "n i"]
    right: Bool[np.ndarray, " n"]

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, str]]) -> "Found":
        """From rows of the table of runs; of several versions of a case the last one counts."""
        families, indicators, right = [], [], []
        for row in {row["case"]: row for row in rows}.values():
            columns = [row[name].split(SEPARATOR) if row[name] else [] for name in ("right", *Indicators._fields)]
            for mark, *values in zip(*columns, strict=True):
                families.append(tuple(row["families"].split(SEPARATOR)) if row["families"] else (NOTHING,))
                indicators.append(within(Indicators(*map(float, values))))
                right.append(mark == "1")
        return cls(families, np.array(indicators).reshape(-1, len(Indicators._fields)), np.array(right, bool))

    def of_family(self, name: str) -> Bool[np.ndarray, " n"]:
        """Which of them are of cases with that cause."""
        return np.array([name in names for names in self.families], bool)


def calibrate(rows: Sequence[Mapping[str, str]], root: Path) -> str:
    """Fit the regression to the table's rows, and write it with a picture; returns a line about it."""
    found = Found.of(rows)
    if len(found.right) < LEAST:
        return f"{len(found.right)} effects were found: too few to fit their probability to (at least {LEAST})."
    penalty = min(PENALTIES, key=lambda c: log_loss(found.right, _held_out(found, c)))
    stated = _held_out(found, penalty)
    whole = _model(penalty).fit(found.indicators, found.right)
    scale, regression = whole.named_steps["standardscaler"], whole.named_steps["logisticregression"]
    weights = regression.coef_[0] / scale.scale_
    bins = list(_bins(stated, found.right))
    content = {
        "intercept": float(regression.intercept_[0] - weights @ scale.mean_),
        "weights": dict(zip(Indicators._fields, weights.tolist(), strict=True)),
        "effects": len(stated), "right": float(found.right.mean()), "penalty": penalty,
        "log_loss_of_families_held_out": float(log_loss(found.right, stated)),
        "log_loss_of_the_share_alone": float(log_loss(found.right, np.full(len(stated), found.right.mean()))),
        "calibration_error": sum(b["effects"] * abs(b["stated"] - b["right"]) for b in bins) / len(stated),
        "bins": bins,
    }  # fmt: skip
    write_json(root / FIT, content)
    plots.stated_and_observed(root / PICTURE, bins, dpi=100)
    return (
        f"{len(stated)} effects were found, {found.right.mean():.0%} with the cause among their names. On families "
        f"held out the stated probability is off by {content['calibration_error']:.3f} on average."
    )


def _model(penalty: float) -> Pipeline:
    return make_pipeline(StandardScaler(), LogisticRegression(C=penalty, max_iter=1000))


def _held_out(found: Found, penalty: float) -> Float[np.ndarray, " n"]:
    """The probability of every effect, fitted to the effects of cases without its family; of two families, the mean."""
    stated, folds = np.zeros(len(found.right)), np.zeros(len(found.right))
    for name in {name for names in found.families for name in names}:
        test = found.of_family(name)
        model = _model(penalty).fit(found.indicators[~test], found.right[~test])
        stated[test] += model.predict_proba(found.indicators[test])[:, 1]
        folds[test] += 1
    return stated / folds


def _bins(stated: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]) -> Sequence[dict[str, Any]]:
    place = np.clip(np.digitize(stated, EDGES) - 1, 0, len(EDGES) - 2)
    return [
        {"from": EDGES[k], "to": EDGES[k + 1], "effects": int((place == k).sum()),
         "stated": float(stated[place == k].mean()), "right": float(right[place == k].mean())}
        for k in range(len(EDGES) - 1) if (place == k).any()
    ]  # fmt: skip
