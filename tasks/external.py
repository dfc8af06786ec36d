"""Stage `external`: machines that nobody here made, diagnosed and scored against what their makers say of them."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from prefect import task

import simgap
from simgap.formats.documents import read_bytes, write_table
from simgap.types import ConfigError
from tasks.params import ExternalCase, ExternalParams

RUNS = Path("reports/external/runs.csv")
KEY = ("code", "case")
"""What a row of the table is known by."""
SURE = 0.95
"""Probability from which on a name is said to be sure."""


def place(root: Path, case: ExternalCase) -> Path:
    """Of the last diagnosis of a machine: its statement and page."""
    return root / "examinations" / "external" / case.name


def earlier(root: Path) -> list[dict[str, str]]:
    """The rows of all runs there were, of every version of the code."""
    path = root / RUNS
    return list(csv.DictReader(read_bytes(path).decode().splitlines())) if path.exists() else []


def keep(root: Path, row: Mapping[str, Any]) -> None:
    """Write one more row, in place of an earlier one of the same code and case."""
    same = [str(row[name]) for name in KEY]
    kept = [old for old in earlier(root) if [old[name] for name in KEY] != same]
    write_table(root / RUNS, [*kept, row])


@task(task_run_name="diagnose-{case.name}")
def diagnose(case: ExternalCase, params: ExternalParams, root: Path) -> dict[str, Any]:
    """The statement on a machine, which is kept with its page.

    Raises ConfigError where its recordings are not there, and the errors of `simgap.diagnose`.
    """
    folder = root / params.folder
    name = case.simulator if ":" in case.simulator else str(folder / case.simulator)
    heldout = tables(folder, case.heldout) if case.heldout else None
    found = simgap.diagnose(name, tables(folder, case.recordings), heldout=heldout, seed=params.seed)
    found.save(place(root, case))
    return found.statement


def tables(folder: Path, patterns: Sequence[str]) -> dict[str, pd.DataFrame]:
    """Sessions that match the patterns, by name; ConfigError names a pattern without any."""
    found: dict[str, pd.DataFrame] = {}
    for pattern in patterns:
        paths = sorted(folder.glob(pattern))
        if not paths:
            raise ConfigError(f"{folder / pattern}: there is no such recording. Bring the machines' recordings there.")
        for path in paths:
            found[f"{path.parent.name}/{path.stem}"] = (
                pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path)
            )
    return found


def judged(case: ExternalCase, statement: Mapping[str, Any]) -> dict[str, Any]:
    """What was said of a machine, and how right that was.

    outcome: `right`, all causes and nothing else, or nothing where nothing is left out; `part`, some of the causes and
    nothing else; `surplus`, a cause and a name that is none; `tied`, no cause, but one is as likely as the name;
    `wrong`, only other names; `open`, no name, and it is said that something may be missing. sure: the greatest
    probability of a name that is not a cause.
    """
    effects = statement["effects"]
    named = {e["id"]: float(e["probability"]) for e in effects}
    found = sum(any(name in named for name in cause) for cause in case.causes)
    other = {name: p for name, p in named.items() if name not in _right(case)}
    errors = {model: scores["error_50"]["value"] for model, scores in statement["fit"]["models"].items()
              if "error_50" in scores}  # fmt: skip
    return {
        "outcome": _outcome(case, statement, found, other),
        "verdict": statement["verdict"],
        "named": "; ".join(f"{name} {p:.2f}" for name, p in named.items()),
        "resembles": "; ".join(e["id"] for e in statement["resembles"]),
        "sure": max(other.values(), default=0.0),
        **{f"error_50_{model}": errors.get(model) for model in ("as_is", "refitted", "augmented", "black_box")},
    }


def _outcome(case: ExternalCase, statement: Mapping[str, Any], found: int, other: Mapping[str, float]) -> str:
    if not statement["effects"]:
        quiet = statement["verdict"] in ("nothing", "parameters_only")
        return "right" if quiet and not case.causes else "wrong" if quiet else "open"
    if found:
        return "surplus" if other else "right" if found == len(case.causes) else "part"
    tied = any(_right(case) & set(e["credible_set"]) for e in statement["effects"])
    return "tied" if tied else "wrong"


def _right(case: ExternalCase) -> set[str]:
    """The effects that name a cause."""
    return {name for cause in case.causes for name in cause}


def failed(why: str) -> dict[str, Any]:
    """The row of a machine that could not be diagnosed."""
    return {"outcome": "failed", "verdict": why}


def summary(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """How many machines there are of every outcome, and how many of them are surely wrong."""
    counts: dict[str, int] = {}
    for row in rows:
        counts[row["outcome"]] = counts.get(row["outcome"], 0) + 1
    sure = sum(float(row.get("sure") or 0.0) >= SURE for row in rows)
    lines = [f"{outcome:8}{count}" for outcome, count in sorted(counts.items(), key=lambda kv: -kv[1])]
    return [*lines, f"{sure} of {len(rows)} have a name that is wrong with a probability of {SURE} or more"]
