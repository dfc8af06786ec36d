"""View of what is missing, what else it could be, and the experiment that would decide."""

from collections.abc import Mapping
from typing import Any

from simgap.diagnosis.report import names
from simgap.diagnosis.report.wording import acts
from simgap.page import numbers, wording
from simgap.page.figures import Figures, source

Values = Mapping[str, Any]

_PLACES = 3  # named in the summary at most


def summary(effect: Values) -> dict[str, Any]:
    """A line of the list of what is missing: name, sizes, places, probability."""
    places = effect.get("channels") or effect.get("outputs") or []
    return {
        "name": wording.either(effect),
        "constants": [_constant(c) for c in effect.get("constants") or []],
        "places": places[:_PLACES],
        "more": max(len(places) - _PLACES, 0),
        "probability": _probability(effect),
        "when": acts(effect.get("support")),
    }


def what(statement: Values, figures: Figures) -> dict[str, Any]:
    """A card per effect, most important first; closest matches, predictable residuals, and the nonparametric law."""
    effects, residuals = statement.get("effects") or [], statement.get("whiteness") or {}
    shares = [{"name": o["name"], "share": numbers.percent(o["share"])} for o in residuals.get("outputs") or []]
    return {
        "cards": [_card(e, figures) for e in wording.by_importance(effects)],
        "none": "" if effects else wording.no_effects(statement),
        "insufficient": (statement["verdict"] == "inconclusive" and statement.get("insufficient")) or [],
        "matches": [
            {"says": e.get("statement", ""), "gain": numbers.fixed(e.get("gain_nats"), 1)}
            for e in wording.by_importance(statement.get("closest_matches") or [])
        ],
        "left": {"shares": shares, "nats": numbers.fixed(residuals.get("nats"), 0)} if shares else None,
        "nonparametric": [
            dict(t) | {"gain": numbers.fixed(t["gain_nats"], 1)} for t in statement.get("nonparametric") or []
        ],
    }


def alternatives(statement: Values, figures: Figures) -> dict[str, Any]:
    """Other sets of effects with their probabilities, and the experiment with the figure of its commands."""
    others = sorted(statement.get("alternatives") or [], key=lambda a: -a["probability"])
    experiment = statement.get("experiment")
    return {
        "rows": [
            {
                "name": " with ".join(map(names.title, a["effects"])) or "nothing missing",
                "probability": numbers.percent(a["probability"]),
                "width": numbers.width(a["probability"]),
            }
            for a in others
        ],
        "no_experiment": wording.no_experiment(statement),
        "experiment": experiment
        and {
            "says": experiment.get("statement", ""),
            "file": experiment.get("commands"),
        },
        "commands": figures.commands and {"src": source(figures.commands["svg"]), "still": figures.commands["still"]},
    }


def _card(effect: Values, figures: Figures) -> dict[str, Any]:
    gains = [
        {"value": numbers.fixed(effect[key], 1), "of": of}
        for key, of in (
            ("gain_nats", "on the sessions fitted"),
            ("heldout_gain_nats", "on held-out sessions"),
            ("misfit_nats", "more on the sessions fitted, if its law could bend"),
        )
        if numbers.known(effect.get(key))
    ]
    title = names.title(effect["id"])
    return {
        "title": title,
        "probability": _probability(effect),
        "width": numbers.width(effect.get("probability")),
        "says": effect.get("statement", ""),
        "constants": [_constant(c) for c in effect.get("constants") or []],
        "channels": effect.get("channels") or [],
        "outputs": effect.get("outputs") or [],
        "gains": gains,
        "acts": acts(effect.get("support")),
        "credible": [names.title(m) for m in effect.get("credible_set") or []],
        "outside": wording.elsewhere(effect),
        "laws": [
            {
                "title": law.get("title", ""),
                "caption": law.get("caption", ""),
                "src": source(law["svg"]),
                "alt": f"{law.get('title', '')} ({title}): measured as dots, the fitted law as a line",
            }
            for law in figures.laws
            if _shows(law, effect)
        ],
    }


def _shows(law: Values, effect: Values) -> bool:
    """Whether a figure is of this effect; other effects may have the same id at another site."""
    return law["effect"] == effect["id"] and all(law.get(key) == effect.get(key) for key in ("form", "where"))


def _probability(effect: Values) -> str:
    return numbers.percent(effect["probability"]) if numbers.known(effect.get("probability")) else ""


def _constant(constant: Values) -> dict[str, str]:
    value, interval = numbers.with_interval(constant.get("value"), constant.get("ci95"))
    return {
        "name": constant["name"],
        "value": value,
        "unit": numbers.unit(constant.get("unit")),
        "interval": interval,
    }
