"""Sentences of the page that depend on the statement; fixed ones stand in the template."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from simgap.diagnosis.report.wording import NO_COMMANDS, listed, title
from simgap.page.marks import MODELS
from simgap.page.numbers import fixed, interval, known, percent

Values = Mapping[str, Any]

HEADLINE_WORDS = 25
"""Most words of the headline."""
VERDICTS = {
    "missing_physics": "Physics is missing",
    "parameters_only": "Only parameters were wrong",
    "nothing": "Nothing is missing",
    "unexplained": "Unexplained mismatch",
    "inconclusive": "Cannot say",
}
_HEADLINES = {
    "parameters_only": "The simulator lacks no physics: other values of its parameters explain the recordings.",
    "nothing": "The simulator lacks nothing that these recordings can show: the two differ by noise only.",
    "unexplained": "The simulator lacks something that none of the known effects explains.",
    "inconclusive": "These recordings cannot show whether the simulator lacks physics.",
}
NO_EFFECTS = {
    "missing_physics": "No effect is described.",
    "parameters_only": "No physics is missing: other parameters of the simulator explain the difference (section 5).",
    "nothing": "No physics is missing: what the simulator and the recordings differ by is noise.",
    "unexplained": "Something is missing that no effect of the vocabulary explains; section 1 says where it shows.",
    "inconclusive": "Whether an effect is missing cannot be said:",
}


def name(effect: Any) -> str:
    """An effect's one name on the page: its id with spaces, its form in brackets (`reach limit (horizontal) on ee`)."""
    ident, on, where = str(effect).partition(" on ")
    return re.sub(r"^([^.]+)\.([^.]+)$", r"\1 (\2)", title(ident)) + on + where


def either(effect: Values) -> str:
    """An effect and what could stand in its place."""
    return " or ".join(name(m) for m in effect.get("credible_set") or [effect["id"]])


def in_words(text: Any, effects: Iterable[str]) -> str:
    """A sentence in which these effects have their names instead of their ids."""
    marked = sorted({e for e in effects if "_" in e}, key=lambda e: (-len(e), e))
    ids = "|".join(map(re.escape, marked))
    return re.sub(rf"(?<!\w)({ids})(?!\w)", lambda m: name(m[0]), str(text)) if ids else str(text)


def ids(statement: Values) -> set[str]:
    """Every effect's id in a statement."""
    experiment, seen = statement.get("experiment") or {}, statement.get("sensitivity") or {}
    tried = [c for r in statement.get("rounds") or [] for c in r.get("candidates") or []]
    found = [str(e["effect"]) for e in (*tried, *(seen.get("effects") or []))]
    found += map(str, experiment.get("separates") or [])
    found += [str(e["id"]) for key in ("effects", "resembles") for e in statement.get(key) or []]
    return {e.partition(".")[0] for e in found}


def by_importance(effects: Sequence[Values]) -> list[Values]:
    """Effects in the order of their held-out gain, then of their gain on the sessions fitted [nats]."""

    def gains(effect: Values) -> tuple[float, ...]:
        both = (effect.get(key) for key in ("heldout_gain_nats", "gain_nats"))
        return tuple(-float(g) if g is not None and known(g) else float("inf") for g in both)

    return sorted(effects, key=gains)


def headline(statement: Values) -> str:
    """What is missing, in at most `HEADLINE_WORDS` words."""
    verdict, effects = str(statement["verdict"]), by_importance(statement.get("effects") or [])
    if verdict != "missing_physics" or not effects:
        return " ".join(_HEADLINES.get(verdict, VERDICTS.get(verdict, verdict)).split()[:HEADLINE_WORDS])
    names = list(dict.fromkeys(map(either, effects)))
    more = " More is missing." if more_is_missing(statement) else ""
    for shown in range(len(names), 0, -1):
        rest = [f"{len(names) - shown} more"] if shown < len(names) else []
        text = f"Missing in the simulator: {_listed([*names[:shown], *rest])}.{more}"
        if len(text.split()) <= HEADLINE_WORDS:
            return text
    return f"Missing in the simulator: {len(names)} effect{'s' if len(names) > 1 else ''}.{more}"


def _listed(names: Sequence[str]) -> str:
    if any(" or " in n for n in names):
        return "; ".join(names)
    return listed(names)


def more_is_missing(statement: Values) -> bool:
    """Whether more is missing than the effects named."""
    left = (statement.get("left_over") or {}).get("outputs")
    return bool(statement.get("something_else") or left or statement.get("law"))


def certainty(statement: Values) -> list[str]:
    """How sure the diagnosis is, most important first."""
    verdict, effects, fit = statement["verdict"], statement.get("effects") or [], statement.get("fit") or {}
    undecided = [e for e in by_importance(effects) if len(e.get("credible_set") or []) > 1]
    lines = [f"{either(e)}: these recordings cannot decide which." for e in undecided]
    if verdict == "inconclusive":
        lines += [f"{r['reason'][:1].upper()}{r['reason'][1:]}." for r in statement.get("insufficient") or []]
    if not effects:
        lines += _closest(statement)
    lines += _errors(fit.get("models") or {})
    share, ends = fit.get("explained_share"), interval(fit.get("explained_share_ci95"))
    if effects and known(share):
        between = f" ({percent(ends[0])} to {percent(ends[1])})" if ends else ""
        lines.append(f"Of the error that a black box can remove, these effects remove {percent(share)}{between}.")
    if effects and more_is_missing(statement):
        lines.append("More is missing than these effects; section 2 shows what is left.")
    chance = (statement.get("sensitivity") or {}).get("chance")
    if verdict in ("nothing", "parameters_only") and known(chance):
        lines.append(f"Effects of the sizes in section 6 would have been found with a chance of {percent(chance)}.")
    return lines


def _closest(statement: Values) -> list[str]:
    """The effect that came closest to being accepted in the last round."""
    tried = (statement.get("rounds") or [{}])[-1]
    best = max(tried.get("candidates") or [], key=lambda c: c["gain_nats"] or 0.0, default=None)
    threshold = tried.get("threshold_nats")
    if best is None or threshold is None or (best["gain_nats"] or 0.0) >= threshold:
        return []
    gains = f"{fixed(best['gain_nats'], 1)} < {fixed(threshold, 1)} nats"
    return [f"The best effect tried ({name(best['effect'])}) gains too little to be named: {gains}."]


def _errors(models: Values) -> list[str]:
    """Held-out errors of the whole state at the longest horizon, model by model."""
    metrics = {m for model in models.values() for m in model or {} if re.fullmatch(r"error_\d+", m)}
    longest = max(metrics, key=lambda m: int(m[6:]), default="")
    shown = [(label, models[m][longest]["value"]) for m, label in MODELS.items() if longest in (models.get(m) or {})]
    if not shown:
        return []
    values = "; ".join(f"{label} {fixed(100 * v, 1) if known(v) else fixed(v, 1)} %" for label, v in shown)
    return [f"Held-out error {_after(longest[6:])}, as a share of the motion: {values}."]


def to_do(statement: Values) -> list[str]:
    """What the reader should do, most important first."""
    verdict = statement["verdict"]
    lines = {
        "missing_physics": ["Add these effects to the simulator, with the constants of section 2."],
        "parameters_only": ["Use the refitted parameters of section 5."],
        "nothing": ["Nothing has to change."],
        "unexplained": [_look(statement.get("located") or {})],
        "inconclusive": [f"{r['remedy']}." for r in statement.get("insufficient") or []],
    }.get(verdict, [])
    if verdict == "unexplained" and statement.get("resembles"):
        lines.append("Compare it with the closest matches of section 2.")
    if statement.get("experiment"):
        lines.append(in_words(statement["experiment"].get("statement", ""), ids(statement)))
    return [line for line in lines if line]


def _look(located: Values) -> str:
    outputs, regimes = (located.get(key) or [] for key in ("outputs", "regimes"))
    where = f" in {max(outputs, key=lambda o: o['excess'])['name']}" if outputs else ""
    where += f", where {max(regimes, key=lambda r: r['share'])['when']}" if regimes else ""
    return f"Look for the cause{where or ' where the mismatch shows'} (section 1)."


def no_experiment(statement: Values) -> str:
    """Why there is no experiment."""
    silent = NO_COMMANDS in (statement.get("notes") or [])
    return f"no {'experiment can be proposed' if silent else 'further experiment is called for'}."


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
