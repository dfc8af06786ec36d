"""Suite `ties`: of cases whose name was a tie, the robot once more in the experiment that the diagnosis prescribed."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from concealed import sessions
from concealed.experiment import experiment
from simgap.formats import statements
from simgap.types import SimgapError
from tasks.params_sealed import TiesParams
from tasks.sealed.judge import MANY, ONE
from tasks.sealed.keys import opened
from tasks.sealed.workspace import PRESCRIBED, RECORDED, SealedWorkspace


class Tie(NamedTuple):
    """A case whose diagnosis left a right and a wrong name, and prescribed an experiment.

    tied: the names. commands: the experiment [T, 6].
    """

    case: str
    key: dict[str, Any]
    tied: list[str]
    commands: np.ndarray

    def conceal(self, recorded: Path, repeats: int, seed: int, folder: Path) -> dict[str, Any]:
        """Write the case's sessions and those of the experiment; returns the key, with the names that were tied."""
        shutil.copytree(recorded, folder / RECORDED)
        sessions.write(folder / PRESCRIBED, *experiment(self.key, self.commands, repeats, seed))
        return {**self.key, "tied": self.tied}


def ties(root: Path, params: TiesParams) -> list[Tie]:
    """Every tie of the suite `params.of`; SimgapError where there is none."""
    workspace = SealedWorkspace(root, params.of)
    found = []
    for case, key in sorted(opened(workspace)[1].items()):
        path = workspace.experiment(case)
        if key["kind"] not in (*ONE, *MANY) or "seed" not in key or _over(key) or not path.exists():
            continue
        tied = tied_names(key, statements.read(workspace.statement(case)))
        if tied:
            commands = np.loadtxt(path, delimiter=",", skiprows=1)[:, 1:]
            found.append(Tie(case, key, tied, commands))
    if not found:
        raise SimgapError(f"{workspace.examinations}: no examined case is a tie with an experiment that may settle it.")
    return found


def tied_names(key: Mapping[str, Any], statement: Mapping[str, Any]) -> list[str]:
    """The credible set that holds a right name of a case and a wrong one; empty where none does."""
    right = {name for effect in key["effects"] for name in effect["accept"]}
    sets: Sequence[list[str]] = [effect["credible_set"] for effect in statement["effects"]]
    return next((names for names in sets if set(names) & right and set(names) - right), [])


def _over(key: Mapping[str, Any]) -> bool:
    """Whether an effect acted during the recordings only: no later experiment shows it."""
    once = (key["when"] or {}).get("session") is not None
    return once or any(c["name"] == "to" for effect in key["effects"] for c in effect["constants"])
