"""Sentences on forecasts of held-out sessions."""

import math
from collections.abc import Mapping
from typing import Any

from simgap.diagnosis.report.names import nominal


def warnings(diagnosis: dict[str, Any]) -> list[str]:
    """What a reader must know before any number on the page."""
    models, lines = diagnosis["fit"]["models"], []
    of = {"nominal": f"the simulator {nominal(diagnosis)}", "refitted": "the refitted simulator",
          "augmented": "the simulator with the effects"}  # fmt: skip
    for worse in diagnosis["fit"]["worse"]:
        for horizon in worse["at"]:
            before, after = (models[m][f"error_{horizon}"]["value"] for m in (worse["than"], worse["model"]))
            lines.append(
                f"On held-out sessions {of[worse['model']]} is worse than {of[worse['than']]} after "
                f"{steps(horizon)}: {_of_motion(after)} against {_of_motion(before)} of the motion."
            )
    return lines


def improvement(diagnosis: dict[str, Any]) -> str:
    """Improvement over the simulator as it is or refitted, whichever is better, at the longest horizon."""
    models, change = diagnosis["fit"]["models"], diagnosis["fit"]["change"]
    if change is None or any("parameters" in e for e in diagnosis["effects"]):
        return ""  # what stands in for a hidden state is no improvement to speak of
    names = {"nominal": nominal(diagnosis), "refitted": "refitted"}
    before, after = (models[m][f"error_{change['at']}"]["value"] for m in (change["than"], "augmented"))
    likelier = min(names, key=lambda m: models[m]["nll_1"]["value"])
    gained = models[likelier]["nll_1"]["value"] - models["augmented"]["nll_1"]["value"]
    chance = "" if clear(change) else ", which may be chance"
    return (
        f" On held-out sessions the error after {steps(change['at'])} goes from {before:.1%} (the simulator "
        f"{names[change['than']]}) to {after:.1%} of the motion{chance}; the one-step log-likelihood changes by "
        f"{gained:+.2f} nats a row against the simulator {names[likelier]}."
    )


def clear(change: Mapping[str, Any]) -> bool:
    """Whether the interval of a change excludes zero. A single piece of a session has an interval of no width."""
    low, high = change["ci95"]
    return low < high and not low <= 0 <= high


def rises(change: Mapping[str, Any] | None) -> bool:
    """Whether an error clearly rises."""
    return change is not None and clear(change) and change["value"] > 0


def _of_motion(error: float) -> str:
    return f"{error:.1%}" if math.isfinite(error) else "infinitely much"


def steps(n: int) -> str:
    """A horizon in words."""
    return "one step" if n == 1 else f"{n} steps"
