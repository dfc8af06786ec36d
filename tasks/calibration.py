"""The probability that the cause is among the names of an effect, fitted to the table of the training ground.

A logistic regression on the indicators of every effect found. It is judged on families of causes that are held out, and
on whole draws that are: nobody's machine is drawn like the ground's.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import log_loss
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from simgap.diagnosis.validation.calibration import WEIGHTS, features
from simgap.diagnosis.validation.indicators import Indicators
from simgap.effects.augmented import Augmented
from simgap.formats.documents import write_json
from simgap.ground.machines import MACHINES
from tasks import plots
from tasks.ground import MEASURED
from tasks.verdicts import FAILED, SEPARATOR

FIT = Path("reports/ground/calibration.json")
PICTURE = Path("reports/ground/calibration.png")
LEAST = 100
"""Effects found: with fewer there is nothing to fit."""
DRAWS = (500, 800, 1100, 1500, 2000, 3000)
"""First cases of the later draws; each draw has other machines, laws or lengths than those before. The 59 cases of the
fifth count with the fourth."""
PENALTIES = (0.001, 0.003, 0.01, 0.03, 0.1, 1.0)
"""Inverse strengths of the ridge penalty on standardised features; held-out families and draws choose one."""
PRIOR = 2.0
"""Wrong findings of an effect that are added at the usual rate, since few were counted."""
EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.0)
"""Of the bins in which stated and observed shares are compared."""
NOTHING = "nothing"


class Found(NamedTuple):
    """What was found in each of c cases, n effects in all.

    numbers, machines, families: of the cases, and of their causes. case: of every effect, its place among the cases.
    right: whether a cause is among its names.
    """

    numbers: Int[np.ndarray, " c"]
    machines: list[str]
    families: list[tuple[str, ...]]
    case: Int[np.ndarray, " n"]
    effects: list[str]
    measured: Float[np.ndarray, "n i"]
    right: Bool[np.ndarray, " n"]

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, str]]) -> "Found":
        """From rows of the table of runs; of several versions of a case the last one counts."""
        cases = [row for row in {row["case"]: row for row in rows}.values() if row["outcome"] != FAILED]
        found = [(c, *cells) for c, row in enumerate(cases) for cells in _cells(row)]
        return cls(
            np.array([int(row["case"]) for row in cases], int),
            [row["machine"] for row in cases],
            [tuple(row["families"].split(SEPARATOR)) if row["families"] else (NOTHING,) for row in cases],
            np.array([c for c, *_ in found], int),
            [effect for _, effect, *_ in found],
            np.array([values for *_, values in found], float).reshape(-1, len(MEASURED)),
            np.array([mark == "1" for _, _, mark, _ in found], bool),
        )

    def of_families(self) -> list[Bool[np.ndarray, " c"]]:
        """For every family of causes, the cases that have it."""
        names = {name for names in self.families for name in names}
        return [np.array([name in names for names in self.families], bool) for name in sorted(names)]

    @property
    def draw(self) -> Int[np.ndarray, " c"]:
        """The draw of every case."""
        return np.digitize(self.numbers, DRAWS)

    def of_draws(self) -> list[Bool[np.ndarray, " c"]]:
        """For every draw, its cases."""
        return [self.draw == k for k in np.unique(self.draw)]

    def mistaken(self, among: Bool[np.ndarray, " c"]) -> tuple[dict[str, float], float]:
        """Wrong findings of every effect per hundred of these cases whose machines may have it, and the usual rate.

        Counted from the draw on in which it was first found: before, the vocabulary may have lacked it.
        """
        wrong, possible = dict.fromkeys(sorted(set(self.effects)), 0), {}
        for c, effect, right in zip(self.case, self.effects, self.right, strict=True):
            wrong[effect] += int(among[c] and not right)
        draw, effects = self.draw, np.array(self.effects)
        for name in wrong:
            counts = among & (draw >= draw[self.case[effects == name]].min())
            possible[name] = sum(name in _possible(self.machines[c]) for c in np.flatnonzero(counts))
        usual = (sum(wrong.values()) + 1) / (sum(possible.values()) + 1)
        rates = {name: 100 * (wrong[name] + PRIOR) / (possible[name] + PRIOR / usual) for name in wrong}
        return rates, 100 * usual

    def features(self, among: Bool[np.ndarray, " c"]) -> Float[np.ndarray, "n f"]:
        """What the weights multiply, for every effect, by wrong findings in these cases."""
        rates, _ = self.mistaken(among)
        return np.array([
            features(Indicators(*values, mistaken=float(np.log(rates[effect]))))
            for values, effect in zip(self.measured.tolist(), self.effects, strict=True)
        ]).reshape(-1, len(WEIGHTS))  # fmt: skip


def _cells(row: Mapping[str, str]) -> list[tuple[str, str, list[float]]]:
    """Name, mark and measured indicators of every effect in a row of the table."""
    columns = [row[name].split(SEPARATOR) if row[name] else [] for name in ("found", "right", *MEASURED)]
    return [(effect, mark, [*map(float, values)]) for effect, mark, *values in zip(*columns, strict=True)]


@cache
def _possible(machine: str) -> frozenset[str]:
    """The effects that a machine of the ground may have."""
    augmented = Augmented(next(m for m in MACHINES if m.name == machine))
    return frozenset(e.id for e, sites in zip(augmented.catalogue, augmented.sites, strict=True) if sites)


def calibrate(rows: Sequence[Mapping[str, str]], root: Path) -> str:
    """Fit the regression to the table's rows, and write it with a picture; returns a line about it."""
    found = Found.of(rows)
    if len(found.right) < LEAST:
        return f"{len(found.right)} effects were found: too few to fit their probability to (at least {LEAST})."
    folds = [_folds(found, parts) for parts in (found.of_families(), found.of_draws())]
    held_out = {c: [_held_out(found, fold, c) for fold in folds] for c in PENALTIES}
    loss = {c: [float(log_loss(found.right, p)) for p in held_out[c]] for c in PENALTIES}
    penalty = min(PENALTIES, key=lambda c: sum(loss[c]))
    stated, _ = held_out[penalty]
    everything = np.ones(len(found.numbers), bool)
    whole = _model(penalty).fit(found.features(everything), found.right)
    scale, regression = whole.named_steps["standardscaler"], whole.named_steps["logisticregression"]
    weights = regression.coef_[0] / scale.scale_
    bins = list(_bins(stated, found.right))
    rates, usual = found.mistaken(everything)
    content = {
        "intercept": float(regression.intercept_[0] - weights @ scale.mean_),
        "weights": dict(zip(map(" x ".join, WEIGHTS), weights.tolist(), strict=True)),
        "mistaken_per_hundred": rates, "usually_mistaken": usual,
        "effects": len(stated), "right": float(found.right.mean()), "penalty": penalty,
        "log_loss_of_families_held_out": loss[penalty][0],
        "log_loss_of_draws_held_out": loss[penalty][1],
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


class _Fold(NamedTuple):
    """Effects of a part that is held out, those of all other cases, and features by wrong findings in these."""

    test: Bool[np.ndarray, " n"]
    train: Bool[np.ndarray, " n"]
    features: Float[np.ndarray, "n f"]


def _folds(found: Found, parts: Sequence[Bool[np.ndarray, " c"]]) -> list[_Fold]:
    """A fold for every part in which something was found. A single part is not held out: all train."""
    kept = [(part, ~part if len(parts) > 1 else part) for part in parts if part[found.case].any()]
    return [_Fold(part[found.case], others[found.case], found.features(others)) for part, others in kept]


def _held_out(found: Found, folds: Sequence[_Fold], penalty: float) -> Float[np.ndarray, " n"]:
    """The probability of every effect, fitted to the cases without its part; of several parts, the mean."""
    stated, times = np.zeros(len(found.right)), np.zeros(len(found.right))
    for fold in folds:
        model = _model(penalty).fit(fold.features[fold.train], found.right[fold.train])
        stated[fold.test] += model.predict_proba(fold.features[fold.test])[:, 1]
        times[fold.test] += 1
    return stated / times


def _bins(stated: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]) -> Sequence[dict[str, Any]]:
    place = np.clip(np.digitize(stated, EDGES) - 1, 0, len(EDGES) - 2)
    return [
        {"from": EDGES[k], "to": EDGES[k + 1], "effects": int((place == k).sum()),
         "stated": float(stated[place == k].mean()), "right": float(right[place == k].mean())}
        for k in range(len(EDGES) - 1) if (place == k).any()
    ]  # fmt: skip
