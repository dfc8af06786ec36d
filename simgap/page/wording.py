"""Sentences of the page that depend on the statement; fixed ones are in the templates."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from simgap.diagnosis.config import LEVEL
from simgap.diagnosis.report.forecasts import clear, rises
from simgap.diagnosis.report.names import by_certainty, either, like_parameters, listed, outside, tied, title
from simgap.diagnosis.report.wording import NO_COMMANDS
from simgap.page.marks import MODELS
from simgap.page.numbers import DASH, fixed, interval, known, number, percent

Values = Mapping[str, Any]

HEADLINE_WORDS = 25
"""Maximum number of words in the headline."""
VERDICTS = {
    "missing_physics": "Physics is missing",
    "parameters_only": "Only parameters were wrong",
    "nothing": "Nothing is missing",
    "unexplained": "Unexplained mismatch",
    "inconclusive": "Cannot say",
}
_HEADLINES = {
    "parameters_only": "No physics is missing: with other parameter values the simulator matches the recordings.",
    "nothing": "Nothing is missing in the simulator: it differs from these recordings by noise only.",
    "unexplained": "Something is missing in the simulator that none of the known effects explains.",
    "inconclusive": "These recordings cannot show whether physics is missing in the simulator.",
}
NO_EFFECTS = {
    "missing_physics": "No effect is described.",
    "parameters_only": "No physics is missing: other parameters of the simulator explain the difference (section 5).",
    "nothing": "No physics is missing: the simulator and the recordings differ by noise only.",
    "unexplained": "Something is missing that none of the known effects explains; section 1 says where it shows.",
    "inconclusive": "The recordings do not show whether an effect is missing:",
}


def elsewhere(effect: Values) -> str:
    """Probability that the cause is another one than the names, unless it is small."""
    return percent(other) if (other := outside(effect)) else ""


def by_importance(effects: Sequence[Values]) -> list[Values]:
    """Effects in the order of their held-out gain, then of their gain on the sessions fitted [nats]."""

    def gains(effect: Values) -> tuple[float, ...]:
        both = (effect.get(key) for key in ("heldout_gain_nats", "gain_nats"))
        return tuple(-float(g) if g is not None and known(g) else float("inf") for g in both)

    return sorted(effects, key=gains)


def headline(statement: Values) -> str:
    """What is missing, in at most `HEADLINE_WORDS` words."""
    verdict, effects = str(statement["verdict"]), by_importance(statement.get("effects") or [])
    if ties := ties_of(statement):
        return _shortened(f"One of these is probably missing: {either(ties[0])}. These recordings cannot tell which.")
    if verdict != "missing_physics" or not effects:
        return _shortened(_HEADLINES.get(verdict, VERDICTS.get(verdict, verdict)))
    certain, likely = (list(dict.fromkeys(map(either, e))) for e in by_certainty(effects))
    more = " Something else is missing too." if more_is_missing(statement) else ""
    shorter_and_shorter = (
        _missing(_first(certain, shown), _first(likely, shown - len(certain))) + more
        for shown in range(len(certain) + len(likely), -1, -1)
    )
    return next(text for text in shorter_and_shorter if len(text.split()) <= HEADLINE_WORDS)


def ties_of(statement: Values) -> list[Values]:
    """Effects of which one is probably missing, most important first."""
    return by_importance(tied(statement))


def no_effects(statement: Values) -> str:
    """Why no effect is named."""
    if ties := ties_of(statement):
        return f"One of several effects is missing, and these recordings cannot tell which: {either(ties[0])}."
    return NO_EFFECTS.get(str(statement["verdict"]), "No effect was found.")


def _shortened(text: str) -> str:
    return " ".join(text.split()[:HEADLINE_WORDS])


def _missing(certain: Sequence[str], likely: Sequence[str]) -> str:
    if not likely:
        return f"Missing in the simulator: {list_of(certain)}."
    if not certain:
        return f"Probably missing in the simulator: {list_of(likely)}."
    return f"Missing in the simulator: {list_of(certain)}. Probably missing too: {list_of(likely)}."


def _first(names: Sequence[str], count: int) -> list[str]:
    """The first names, and the number of the others."""
    shown = list(names[: max(count, 0)])
    left = len(names) - len(shown)
    return [*shown, f"{left} more" if shown else f"{left} effect{'s' if left > 1 else ''}"] if left else shown


def list_of(names: Sequence[str]) -> str:
    """Names as a list of a sentence, apart where one of them is a choice."""
    if any(" or " in n for n in names):
        return "; ".join(names)
    return listed(names)


def more_is_missing(statement: Values) -> bool:
    """Whether more is missing than the effects named."""
    left = (statement.get("whiteness") or {}).get("outputs")
    return bool(statement.get("more_missing") or left or statement.get("nonparametric"))


def certainty(statement: Values) -> list[str]:
    """How certain the diagnosis is, most important first."""
    verdict, effects = statement["verdict"], statement.get("effects") or []
    undecided = [e for e in by_importance(effects) if len(e.get("credible_set") or []) > 1]
    lines = [f"{either(e)}: these recordings cannot decide which." for e in undecided]
    lines += [
        f"With a probability of {percent(1 - e['outside'])} it is {either(e)}; none by itself has more than "
        f"{percent(e['probability'])}."
        for e in ties_of(statement)
    ]
    doubtful = [e for e in by_importance(effects) if elsewhere(e)]
    lines += [f"{either(e)}: with a probability of {elsewhere(e)} the cause is another one." for e in doubtful]
    if verdict == "inconclusive":
        lines += [f"{r['reason'][:1].upper()}{r['reason'][1:]}." for r in statement.get("insufficient") or []]
    lines += _against_chance(statement)
    if effects and more_is_missing(statement):
        lines.append("Something else is missing too: section 2 shows what is left.")
    power = (statement.get("sensitivity") or {}).get("power")
    if verdict in ("nothing", "parameters_only") and known(power):
        lines.append(f"Effects of the sizes in section 6 would be found with a probability of {percent(power)}.")
        alike = like_parameters((statement.get("sensitivity") or {}).get("imitated_effects") or [])
        lines += [alike] if alike else []
    return lines


def _against_chance(statement: Values) -> list[str]:
    """Probability that noise alone gains as much as the named effects or, without any, as the best effect tried."""
    rounds = statement.get("rounds") or []
    if statement.get("effects"):
        chances = [r["p_value"] for r in rounds if r.get("accepted") and known(r.get("p_value"))]
        return [f"Noise alone would gain as much with a probability of {number(max(chances), 2)}."] if chances else []
    last = rounds[-1] if rounds else {}
    best = max(last.get("hypotheses") or [], key=lambda c: c["gain_nats"] or 0.0, default=None)
    if best is None or last.get("accepted") or not by_chance(last):
        return []
    best_of_all, chance = f"The best effect tried is {title(best['effect'])}", number(last["p_value"], 2)
    return [f"{best_of_all}; noise alone gains as much with a probability of {chance}."]


def by_chance(tried: Values) -> bool:
    """Whether noise alone may gain as much as the best effect of a round."""
    return known(tried.get("p_value")) and tried["p_value"] > LEVEL


def longest(models: Values) -> str:
    """The error of the whole state at the longest horizon that any model has, such as `error_50`; empty for none."""
    errors = {m for model in models.values() for m in model or {} if re.fullmatch(r"error_\d+", m)}
    return max(errors, key=lambda m: int(m[6:]), default="")


def helps(statement: Values) -> list[str]:
    """Whether the effects named improve forecasts of held-out sessions."""
    fit = statement.get("fit") or {}
    models, explained = fit.get("models") or {}, fit.get("explained_share")
    score, ends = longest(models), interval(fit.get("explained_share_ci95"))
    errors = {m: models[m][score]["value"] for m in MODELS if score in (models.get(m) or {})}
    after, before = errors.get("augmented"), [errors[m] for m in ("nominal", "refitted") if known(errors.get(m))]
    lines = []
    if statement.get("effects") and before and known(after):
        lines.append(_answer(fit.get("change"), f"from {share(min(before))} to {share(after)} of the motion"))
    if statement.get("effects") and known(explained):
        between = f" ({percent(ends[0])} to {percent(ends[1])})" if ends and ends[0] < ends[1] else ""
        lines.append(f"What was found removes {percent(explained)}{between} of the error that a black box can remove.")
    return lines


def _answer(change: Values | None, errors: str) -> str:
    """Whether the held-out error falls. A statement from before 30 November 2026 has no interval of its change."""
    if change is None:
        return f"Held-out error goes {errors}."
    if not clear(change):
        return f"Not clear: held-out error goes {errors}, which may be chance."
    return f"No: held-out error rises {errors}." if rises(change) else f"Yes: held-out error falls {errors}."


def share(error: Any) -> str:
    """An error as a share of the motion, to a tenth of a percent."""
    return f"{fixed(100 * error, 1)} %" if known(error) else DASH


def no_experiment(statement: Values) -> str:
    """Why there is no experiment."""
    silent = NO_COMMANDS in (statement.get("notes") or [])
    return f"no {'experiment can be proposed' if silent else 'further experiment is needed'}."


def metric(key: str) -> tuple[str, str]:
    """Label and unit of a score such as `nll_1`, `error_50` or `error_50_base [m]`."""
    parts = re.fullmatch(r"(nll|error)_(\d+)(?:_([^\[]+?))?\s*(?:\[(.*)\])?", key)
    if not parts:
        return key.replace("_", " "), ""
    kind, steps, body, unit = parts.groups()
    what = ("Error" if kind == "error" else "NLL") + (f" of {body.replace('_', ' ')}" if body else "")
    return f"{what} {_after(steps)}", unit or ("nats a row" if kind == "nll" else "of the motion")


def _after(steps: str) -> str:
    return "one step ahead" if steps == "1" else f"after {steps} steps"
