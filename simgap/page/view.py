"""The statement as the page shows it: text and numbers in their final form, in the order of the page."""

from collections.abc import Mapping
from typing import Any

from simgap.page import effects, marks, numbers, scores, tried, where, wording
from simgap.page.figures import Figures
from simgap.page.to_do import to_do

Values = Mapping[str, Any]

_SESSIONS = 6  # named at most


def view(statement: Values, figures: Figures) -> dict[str, Any]:
    """What the template shows: plain text, not yet escaped.

    `statement` is what diagnosis.json holds; only its `verdict` is required, any other part may be absent. Raises
    KeyError without a verdict.
    """
    return {
        "summary": _summary(statement),
        "where": where.where(statement, figures),
        "what": effects.what(statement, figures),
        "scores": scores.scores(statement, figures),
        "alternatives": effects.alternatives(statement, figures),
        "parameters": scores.parameters(statement),
        "tried": tried.tried(statement),
    }


def _summary(statement: Values) -> dict[str, Any]:
    """What is missing, how sure that is, whether it helps, and what to do."""
    verdict = str(statement["verdict"])
    return {
        "title": f"Diagnosis of {statement.get('simulator', 'the simulator')}",
        "verdict": wording.VERDICTS.get(verdict, verdict),
        "kind": verdict if verdict in wording.VERDICTS else "other",
        "headline": wording.headline(statement),
        "warnings": statement.get("warnings") or [],
        "missing": [effects.summary(e) for e in wording.by_importance(statement.get("effects") or [])],
        "certainty": wording.certainty(statement),
        "helps": wording.helps(statement),
        "errors": _errors(statement),
        "to_do": to_do(statement),
        "statement": statement.get("statement", ""),
        "facts": _facts(statement.get("recordings") or {}),
    }


def _errors(statement: Values) -> dict[str, Any] | None:
    """Held-out errors at the longest horizon, by model; bars are relative to the largest."""
    models, labels = (statement.get("fit") or {}).get("models") or {}, marks.labels(statement)
    score = wording.longest(models)
    errors = {m: models[m][score]["value"] for m in marks.MODELS if score in (models.get(m) or {})}
    finite = [e for e in errors.values() if numbers.known(e)]
    if not finite:
        return None
    return {
        "caption": f"Held-out error {wording.metric(score)[0].partition(' ')[2]}, share of the motion",
        "rows": [
            {
                "label": labels[m],
                "colour": marks.COLOURS[m],
                "value": wording.share(e),
                "width": numbers.width(e / max(finite)) if max(finite) else "0",
            }
            for m, e in errors.items()
        ],
    }


def _facts(recordings: Values) -> list[str]:
    """Facts about the recordings."""
    facts = []
    if recordings.get("transitions") is not None:
        facts.append(f"{recordings['transitions']:,} transitions")
    if numbers.known(recordings.get("duration_s")):
        facts.append(numbers.duration(recordings["duration_s"]))
    for key, what in (("training_sessions", "for fitting"), ("heldout_sessions", "held out")):
        sessions = [str(s) for s in recordings.get(key) or []]
        more = f" and {len(sessions) - _SESSIONS} more" if len(sessions) > _SESSIONS else ""
        names = f" ({', '.join(sessions[:_SESSIONS])}{more})" if sessions else ""
        facts.append(f"{numbers.count(len(sessions), 'session')} {what}{names}")
    baseline = recordings.get("baseline")
    if baseline:
        names = ", ".join(map(str, baseline)) if isinstance(baseline, list) else str(baseline)
        facts.append(f"compared with the baseline {names}")
    return facts
