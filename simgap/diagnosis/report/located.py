"""Where the mismatch is: outputs, regimes and times by the gain of the best explanation, row by row."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.hypotheses.support import From, Window
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.misfit.whiteness import Whiteness, whiteness
from simgap.diagnosis.likelihood.problem import evaluate, raw_innovations
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.diagnosis.report import localisation
from simgap.diagnosis.validation import black_box
from simgap.diagnosis.validation.black_box import BlackBox
from simgap.effects.regime import Regime, features
from simgap.types import Recording

MISMATCH = ("missing_physics", "unexplained")
"""Verdicts with something to locate."""


def located(
    found: Explanation, fitted: Sequence[Recording], verdict: str, box: BlackBox, left: Whiteness
) -> dict[str, Any]:
    """Outputs, regimes and times of the mismatch, and, where it is unexplained, what it depends on (`left`: how far
    residuals are predictable). Empty without a mismatch."""
    problem = found.problem
    if verdict not in MISMATCH:
        return {"outputs": [], "regimes": [], "intervals": [], "depends_on": []}
    where = excess(found, verdict, box, problem.chunks)
    return {
        "outputs": localisation.outputs(problem.augmented, where),
        "regimes": _regimes(found, where),
        "intervals": _intervals(found, where, fitted),
        "depends_on": _depends_on(found, left) if verdict == "unexplained" else [],
    }


def excess(found: Explanation, verdict: str, box: BlackBox, chunks: Chunks) -> localisation.Excess:
    """Gain of the best explanation over the refitted simulator: the effects, if they are named.

    Otherwise the best of three models: the black box, the effects with the predictable part of their innovations, and
    the effects with the nonparametric law.
    """
    problem = found.problem._replace(chunks=chunks)
    base, fitted = (raw_innovations(problem, f.v) for f in (found.base, found.fit))
    if verdict == "missing_physics":
        return localisation.excess(problem.augmented, chunks, base, fitted)
    predicted = black_box.predicted(problem, found.base.v, box)
    evaluated = evaluate(problem, found.fit.v, (), found.fit.noise)
    with_law = found.law.fitted if chunks is found.problem.chunks else found.law.heldout

    def minus(e: Float[np.ndarray, "n s"]) -> Float[np.ndarray, "C t s"]:
        """Innovations with the effects, minus the decorrelated ones `e` of the scored rows."""
        part = np.zeros_like(fitted)
        part[np.asarray(chunks.counts)] = e @ np.linalg.inv(problem.whiten).T
        return fitted - part

    better = (
        base - predicted[..., : base.shape[-1]],
        minus(whiteness(problem, evaluated).predicted),
        minus(evaluated.e - with_law),
    )
    return max((localisation.excess(problem.augmented, chunks, base, e) for e in better), key=lambda e: e.nats.sum())


def _depends_on(found: Explanation, left: Whiteness) -> list[dict[str, Any]]:
    """Inputs of the unexplained part: its own past, with its predictable share, and inputs of the nonparametric law,
    with their shares of its gain."""
    gains: dict[str, float] = {}
    for term in found.law.terms:
        for name in term.depends_on:
            gains[name] = gains.get(name, 0.0) + term.gain
    total = sum(t.gain for t in found.law.terms)
    depends = [("its own past", float(left.share.max())), *((name, gain / total) for name, gain in gains.items())]
    return [{"input": i, "share": s} for i, s in sorted(depends, key=lambda d: -d[1]) if s > 0]


def _regimes(found: Explanation, where: localisation.Excess) -> list[dict[str, Any]]:
    """The regimes of the effects' supports, then those of other features that hold most of the excess."""
    layout, excess = found.problem.augmented.layout, localisation.regimes(where)
    supports = (m.hypothesis.support for m in found.members)
    own = list(dict.fromkeys(s for s in supports if isinstance(s, Regime)))
    names = tuple(f"{features(layout)[regime.feature].name} " for regime in own)
    others = (r for r in excess if not r["regime"].startswith(names))
    return [*(localisation.share(where, layout, regime) for regime in own), *others]


def _intervals(found: Explanation, where: localisation.Excess, fitted: Sequence[Recording]) -> list[dict[str, Any]]:
    """The onsets and windows of the effects; without any, the window that holds most of the excess."""
    intervals = []
    for support in (m.hypothesis.support for m in found.members):
        match support:
            case From(from_s):
                affected, to_s = fitted, np.inf
            case Window(session, from_s, to_s):
                affected = [fitted[session]]
            case _:
                continue
        for r in affected:
            duration = float(r.time_s[-1] - r.time_s[0])
            if duration > from_s:
                intervals.append({"session": r.name, "from_s": from_s, "to_s": min(to_s, duration), "share": None})
    return intervals or localisation.intervals(where, fitted)
