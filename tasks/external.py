"""Stage `external`: machines that nobody here made, diagnosed and scored against what their makers say of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from prefect import task

import simgap
from simgap.types import ConfigError
from tasks import verdicts
from tasks.params_machines import ExternalCase, ExternalParams

RUNS = Path("reports/external/runs.csv")


def place(root: Path, case: ExternalCase) -> Path:
    """Of the last diagnosis of a machine: its statement and page."""
    return root / "examinations" / "external" / case.name


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


def row_of(case: ExternalCase, statement: Mapping[str, Any]) -> dict[str, Any]:
    """What was said of a machine, how right that was, and what forecasts over 50 rows miss."""
    errors = {model: scores["error_50"]["value"] for model, scores in statement["fit"]["models"].items()
              if "error_50" in scores}  # fmt: skip
    shown = {f"error_50_{model}": errors.get(model) for model in ("nominal", "refitted", "augmented", "black_box")}
    return verdicts.judged(case.causes, statement) | shown
