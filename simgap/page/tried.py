"""View of the rounds of the search, and of what they could not have found."""

from collections.abc import Mapping
from typing import Any

from simgap.page import numbers
from simgap.page.wording import ids, in_words, name

Values = Mapping[str, Any]

_CANDIDATES = 8  # of a round, shown at most


def tried(statement: Values) -> dict[str, Any]:
    """Rounds with their candidates by gain, the smallest sizes that would have been found, and notes."""
    seen, known = statement.get("sensitivity") or {}, ids(statement)
    return {
        "rounds": [_round(r) for r in statement.get("rounds") or []],
        "chance": numbers.percent(seen.get("chance")),
        "sizes": _sizes(seen),
        "notes": [in_words(note, known) for note in statement.get("notes") or []],
    }


def _round(tried: Values) -> dict[str, Any]:
    candidates = sorted(tried.get("candidates") or [], key=lambda c: -(c["gain_nats"] or 0))
    accepted, threshold = tried.get("accepted"), tried.get("threshold_nats")
    limits = [f"threshold {numbers.fixed(threshold, 1)} nats"] if numbers.known(threshold) else []
    limits += [f"p = {numbers.number(tried['p_value'], 2)}"] if numbers.known(tried.get("p_value")) else []
    top = 1.02 * max([threshold or 0.0, *(c["gain_nats"] or 0.0 for c in candidates)]) or 1.0
    return {
        "accepted": name(accepted) if accepted else "",
        "limits": ", ".join(limits),
        "threshold": numbers.width(threshold / top) if threshold is not None and numbers.known(threshold) else "",
        "rows": [_candidate(c, top, accepted) for c in candidates[:_CANDIDATES]],
        "more": max(len(candidates) - _CANDIDATES, 0),
        "most": _gain(candidates[_CANDIDATES]) if len(candidates) > _CANDIDATES else "",
    }


def _candidate(candidate: Values, top: float, accepted: Any) -> dict[str, Any]:
    effect, place = str(candidate["effect"]), str(candidate.get("where") or "")
    full = f"{effect} on {place}" if place else effect
    return {
        "name": name(full), "gain": _gain(candidate), "width": numbers.width((candidate["gain_nats"] or 0.0) / top),
        "accepted": accepted in (full, effect),
    }  # fmt: skip


def _gain(candidate: Values) -> str:
    return f"{numbers.fixed(candidate['gain_nats'], 1)} nats"


def _sizes(seen: Values) -> list[dict[str, Any]]:
    """For every effect the smallest size that would have been found, site by site, and the sites where none would."""
    effects: dict[str, dict[str, Any]] = {}
    for visible in seen.get("effects") or []:
        row = effects.setdefault(visible["effect"], {"name": name(visible["effect"]), "sizes": [], "hidden": []})
        if numbers.known(visible["size"]):
            size = f"{visible['constant']} {numbers.number(visible['size'])} {numbers.unit(visible['unit'])}".rstrip()
            row["sizes"].append({"where": visible["where"], "size": size})
        else:
            row["hidden"].append(visible["where"])
    return list(effects.values())
