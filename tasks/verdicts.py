"""How right a statement is about a machine whose causes are known, and the table of such runs."""

import csv
import threading
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from simgap.formats.documents import read_bytes, write_table

KEY = ("code", "case")
"""What a row of a table is known by: the version of the diagnosing code, and the machine."""
SURE = 0.95
"""Probability from which on a name is said to be sure."""
FAILED = "failed"
SEPARATOR = "; "
"""Between the parts of a cell."""


class Runs:
    """The table of all runs, of which this version of the code adds rows; safe to use from several threads."""

    def __init__(self, path: Path, code: str) -> None:
        self.path, self.code = path, code
        self._alone = threading.Lock()

    @property
    def every(self) -> list[dict[str, str]]:
        """The rows of every version."""
        return list(csv.DictReader(read_bytes(self.path).decode().splitlines())) if self.path.exists() else []

    @property
    def own(self) -> list[dict[str, str]]:
        """The rows of this version."""
        return [row for row in self.every if row["code"] == self.code]

    @property
    def done(self) -> set[str]:
        """The cases that this version has diagnosed."""
        return {row["case"] for row in self.own if row["outcome"] != FAILED}

    def keep(self, row: Mapping[str, Any]) -> None:
        """Write one more row, in place of an earlier one of the same code and case."""
        row = {"code": self.code, **row}
        with self._alone:
            same = [str(row[name]) for name in KEY]
            write_table(self.path, [*(old for old in self.every if [old[name] for name in KEY] != same), row])


def judged(causes: Sequence[Collection[str]], statement: Mapping[str, Any]) -> dict[str, Any]:
    """What was said, and how right that was. causes: for each of them, the effects that name it rightly.

    outcome: `right`, all causes and nothing else, or nothing where nothing is left out; `part`, some of the causes and
    nothing else; `surplus`, a cause and a name that is none; `tied`, no cause, but one is as likely as the name;
    `wrong`, only other names; `open`, no name, and it is said that something may be missing. sure: the greatest
    probability of a name that is not a cause.
    """
    named = {e["id"]: float(e["probability"]) for e in statement["effects"]}
    found = sum(any(name in named for name in cause) for cause in causes)
    other = {name: p for name, p in named.items() if name not in _right(causes)}
    return {
        "outcome": _outcome(causes, statement, found, other),
        "verdict": statement["verdict"],
        "named": SEPARATOR.join(f"{name} {p:.2f}" for name, p in named.items()),
        "closest_matches": SEPARATOR.join(e["id"] for e in statement["closest_matches"]),
        "sure": max(other.values(), default=0.0),
    }


def _outcome(
    causes: Sequence[Collection[str]], statement: Mapping[str, Any], found: int, other: Mapping[str, float]
) -> str:
    if not statement["effects"]:
        quiet = statement["verdict"] in ("nothing", "parameters_only")
        return "right" if quiet and not causes else "wrong" if quiet else "open"
    if found:
        return "surplus" if other else "right" if found == len(causes) else "part"
    tied = any(is_right(causes, e) for e in statement["effects"])
    return "tied" if tied else "wrong"


def is_right(causes: Sequence[Collection[str]], effect: Mapping[str, Any]) -> bool:
    """Whether a cause is among the names of an effect's credible set."""
    return bool(_right(causes) & set(effect["credible_set"]))


def _right(causes: Sequence[Collection[str]]) -> set[str]:
    """The effects that name a cause."""
    return {name for cause in causes for name in cause}


def failed(why: str) -> dict[str, Any]:
    """The row of a machine that could not be diagnosed."""
    return {"outcome": FAILED, "verdict": why}


def summary(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """How many machines there are of every outcome, and how many of them are surely wrong."""
    counts: dict[str, int] = {}
    for row in rows:
        counts[row["outcome"]] = counts.get(row["outcome"], 0) + 1
    sure = sum(float(row.get("sure") or 0.0) >= SURE for row in rows)
    lines = [f"{outcome:8}{count}" for outcome, count in sorted(counts.items(), key=lambda kv: -kv[1])]
    return [*lines, f"{sure} of {len(rows)} have a name that is wrong with a probability of {SURE} or more"]
