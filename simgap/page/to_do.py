"""What the reader of a page should do."""

from collections.abc import Sequence

from simgap.diagnosis.report.forecasts import rises
from simgap.diagnosis.report.names import by_certainty, either
from simgap.page.wording import Values, by_importance, list_of, ties_of

ADD = "Add these effects to the simulator (constants in section 2), or load the corrected one with simgap.load()."
DO_NOT = "Do not forecast with these effects: they raise the held-out error."


def to_do(statement: Values) -> list[str]:
    """What the reader should do, most important first."""
    verdict, change = statement["verdict"], (statement.get("fit") or {}).get("change")
    _, likely = by_certainty(by_importance(statement.get("effects") or []))
    lines = {
        "missing_physics": [_to_check(likely), DO_NOT if rises(change) else _use(statement, ADD)],
        "parameters_only": [_use(statement, "Use the refitted parameters of section 5.")],
        "nothing": ["Nothing has to change."],
        "unexplained": [_to_check(ties_of(statement)) or _look(statement.get("located") or {})],
        "inconclusive": [f"{r['remedy']}." for r in statement.get("insufficient") or []],
    }.get(verdict, [])
    if verdict == "unexplained" and statement.get("closest_matches"):
        lines.append("Compare it with the closest matches of section 2.")
    if statement.get("experiment"):
        lines.append(statement["experiment"].get("statement", ""))
    return [line for line in lines if line]


def _use(statement: Values, otherwise: str) -> str:
    """To use the patched model, if the simulator is a model file and something could be written into it."""
    patched = statement.get("patched") or {}
    if not patched.get("changes"):
        return otherwise
    more = " It lacks what MJCF cannot express; simgap.load() has that too." if patched["unwritten"] else ""
    return f"Use {patched['file']} in place of the model; section 5 lists its changes.{more}"


def _to_check(likely: Sequence[Values]) -> str:
    names = list(dict.fromkeys(map(either, likely)))
    are = "is" if len(names) == 1 else "are"
    return f"Check on the machine: {list_of(names)} {are} likely, not certain." if names else ""


def _look(located: Values) -> str:
    outputs, regimes = (located.get(key) or [] for key in ("outputs", "regimes"))
    where = f" in {max(outputs, key=lambda o: o['excess'])['name']}" if outputs else ""
    where += f", where {max(regimes, key=lambda r: r['share'])['regime']}" if regimes else ""
    return f"Look for the cause{where or ' where the mismatch shows'} (section 1)."
