"""View of the rounds of the search, and of the sizes that would have been found."""

from collections.abc import Mapping, Sequence
from typing import Any

from simgap.diagnosis.report.names import title
from simgap.page import numbers, wording

Values = Mapping[str, Any]

_HYPOTHESES = 8  # of a round, shown at most


def tried(statement: Values) -> dict[str, Any]:
    """Rounds with their hypotheses by gain, the smallest sizes that would have been found, and notes."""
    seen, rounds = statement.get("sensitivity") or {}, statement.get("rounds") or []
    return {
        "rounds": [_round(r, retested(rounds[:i], r)) for i, r in enumerate(rounds)],
        "power": numbers.percent(seen.get("power")),
        "sizes": _sizes(seen),
        "notes": statement.get("notes") or [],
    }


def retested(before: Sequence[Values], tried: Values) -> str:
    """The accepted effect that a round only compares with its alternatives, given the others; empty for a search.

    A search leaves out accepted effects, so a round that tries one again is not a search.
    """
    again = [_full(c) for c in tried.get("hypotheses") or []]
    accepted = [r["accepted"] for r in before if r.get("accepted")]
    return next((name for name in accepted if name in again and not tried.get("accepted")), "")


def _round(tried: Values, own: str) -> dict[str, Any]:
    accepted, chance = tried.get("accepted"), wording.by_chance(tried)
    threshold = tried.get("threshold_nats")
    drawn = numbers.known(threshold) and not chance and not own
    hypotheses = _best_of_each(tried)
    top = 1.02 * max([threshold if drawn and threshold else 0.0, *(c["gain_nats"] or 0.0 for c in hypotheses)]) or 1.0
    return {
        "accepted": title(accepted) if accepted else "",
        "retested": title(own),
        "limits": _limits(tried, chance) if not own else "",
        "threshold": numbers.width(threshold / top) if drawn and threshold else "",
        "rows": [_hypothesis(c, top, accepted or own) for c in hypotheses[:_HYPOTHESES]],
        "more": max(len(hypotheses) - _HYPOTHESES, 0),
        "most": _gain(hypotheses[_HYPOTHESES]) if len(hypotheses) > _HYPOTHESES else "",
    }


def _limits(tried: Values, chance: bool) -> str:
    threshold, p_value = tried.get("threshold_nats"), tried.get("p_value")
    if chance:
        return f"noise alone gains as much with a probability of {numbers.number(p_value, 2)}"
    limits = [f"threshold {numbers.fixed(threshold, 1)} nats"] if numbers.known(threshold) else []
    return ", ".join(limits + ([f"p = {numbers.number(p_value, 2)}"] if numbers.known(p_value) else []))


def _best_of_each(tried: Values) -> list[Values]:
    """Every hypothesis once, with its largest gain, sorted by gain: some are tried from several starts."""
    best: dict[str, Values] = {}
    for hypothesis in sorted(tried.get("hypotheses") or [], key=lambda c: -(c["gain_nats"] or 0)):
        best.setdefault(_full(hypothesis), hypothesis)
    return list(best.values())


def _full(hypothesis: Values) -> str:
    place = hypothesis.get("where")
    return f"{hypothesis['effect']} on {place}" if place else str(hypothesis["effect"])


def _hypothesis(hypothesis: Values, top: float, chosen: str) -> dict[str, Any]:
    return {
        "name": title(_full(hypothesis)), "gain": _gain(hypothesis),
        "width": numbers.width((hypothesis["gain_nats"] or 0.0) / top),
        "chosen": chosen in (_full(hypothesis), hypothesis["effect"]),
    }  # fmt: skip


def _gain(hypothesis: Values) -> str:
    return f"{numbers.fixed(hypothesis['gain_nats'], 1)} nats"


def _sizes(seen: Values) -> list[dict[str, Any]]:
    """For every effect, the smallest size that would have been found per site, and the sites where none would."""
    effects: dict[str, dict[str, Any]] = {}
    for visible in seen.get("effects") or []:
        row = effects.setdefault(visible["effect"], {"name": title(visible["effect"]), "sizes": [], "hidden": []})
        if numbers.known(visible["size"]):
            size = f"{visible['constant']} {numbers.number(visible['size'])} {numbers.unit(visible['unit'])}".rstrip()
            row["sizes"].append({"where": visible["where"], "size": size})
        else:
            row["hidden"].append(visible["where"])
    return list(effects.values())
