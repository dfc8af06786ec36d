"""Names and numbers as people read them."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from simgap.diagnosis.config import CREDIBLE, KNOWN, LIKELY
from simgap.types import Field

LISTED = 6
"""Maximum number of names in a sentence."""


def number(value: float, digits: int = 3) -> str:
    """A number to some significant digits; thousands are written out, not as powers of ten."""
    return f"{float(f'{value:.{digits}g}'):g}"


def quantity(constant: dict[str, Any]) -> str:
    """Value and unit."""
    unit = "" if constant["unit"] == "-" else f" {constant['unit']}"
    return f"{number(constant['value'])}{unit}"


def title(effect: str) -> str:
    """An effect's one name: its id with spaces, its form in brackets, like `reach limit (horizontal) on ee_vx`.

    Names of channels and outputs, after ` on `, stay as they are.
    """
    ident, on, where = effect.partition(" on ")
    return re.sub(r"^([^.]+)\.([^.]+)$", r"\1 (\2)", ident.replace("_", " ")) + on + where


def nominal(diagnosis: Mapping[str, Any]) -> str:
    """Which simulator the nominal one of a diagnosis is: not a model file itself if the search started elsewhere."""
    return "as the search began" if (diagnosis.get("model_file") or {}).get("start") else "as it is"


def outside(effect: Mapping[str, Any]) -> float:
    """Probability that the cause of an effect is another one than its names; 0 if it is a small one."""
    probability = effect.get("outside") or 0.0
    return probability if probability > 1 - CREDIBLE else 0.0


def by_certainty(effects: Iterable[Mapping[str, Any]]) -> tuple[list[Mapping[str, Any]], list[Mapping[str, Any]]]:
    """Effects whose cause is among their names, surely, and those for which it is only likely."""
    certain, likely = [], []
    for effect in effects:
        (likely if outside(effect) else certain).append(effect)
    return certain, likely


def tied(diagnosis: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Effects of which one is likely missing, where none has a name: none of them is likely by itself."""
    effects = (diagnosis.get("closest_matches") or []) if diagnosis["verdict"] == "unexplained" else []
    likely = (e for e in effects if (e.get("outside") or 0.0) <= 1 - KNOWN)
    return [e for e in likely if len(e["credible_set"]) > 1 and e["probability"] < LIKELY]


def either(effect: Mapping[str, Any]) -> str:
    """An effect and its alternatives, the names in its credible set: `a, b or c`."""
    *others, last = [title(m) for m in effect.get("credible_set") or [effect["id"]]]
    return f"{', '.join(others)} or {last}" if others else last


def in_steps(outputs: Sequence[Field], steps: Iterable[float]) -> list[str]:
    """A note on the outputs whose readings come in steps; none without any."""
    each = [f"{f.name} {number(step)} {f.unit}" for f, step in zip(outputs, steps, strict=True) if step]
    return [f"Readings come in steps: {', '.join(each)}. What is smaller than a step may be hidden."] if each else []


def like_parameters(imitated: Sequence[str]) -> str:
    """The sentence on effects that other values of the parameters imitate; empty for none."""
    names = listed([title(effect) for effect in imitated])
    return f"{names[:1].upper()}{names[1:]} would look like other values of the parameters." if names else ""


def listed(names: Sequence[str]) -> str:
    """`a, b and c`; if there are many, the first ones and the number of the others: `a, b, c and 4 more`."""
    if len(names) > LISTED:
        names = [*names[: LISTED - 1], f"{len(names) - LISTED + 1} more"]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
