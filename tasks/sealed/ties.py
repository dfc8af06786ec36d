"""Suite `ties`: of cases whose name was a tie, the robot once more in the experiment that the diagnosis prescribed."""

import csv
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from concealed import seal, sessions
from concealed.experiment import experiment
from simgap.formats import statements
from simgap.formats.documents import read_bytes, read_json
from simgap.types import SimgapError
from tasks.params import TiesParams
from tasks.sealed.judge import MANY, ONE
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


def keys_of(workspace: SealedWorkspace) -> dict[str, dict[str, Any]]:
    """The keys of a suite; SimgapError where they are not those whose hashes were published."""
    manifest = read_json(workspace.manifest)
    if read_json(workspace.published) != manifest:
        raise SimgapError(f"{workspace.published}: must be the manifest of the recordings, {workspace.manifest}.")
    try:
        return seal.unseal(read_bytes(workspace.sealed), read_bytes(workspace.secret), manifest["keys"])
    except seal.BrokenSealError as error:
        raise SimgapError(f"{workspace.sealed}: {error}") from None


def ties(root: Path, params: TiesParams) -> list[Tie]:
    """Every tie of the suite `params.of`; SimgapError where there is none."""
    workspace = SealedWorkspace(root, params.of)
    found = []
    for case, key in sorted(keys_of(workspace).items()):
        path = workspace.experiment(case)
        if key["kind"] not in (*ONE, *MANY) or "seed" not in key or _over(key) or not path.exists():
            continue
        tied = tied_names(key, statements.read(workspace.statement(case)))
        if tied:
            found.append(Tie(case, key, tied, _commands(path)))
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


def _commands(path: Path) -> np.ndarray:
    """The commands of an experiment, without their times."""
    with path.open(newline="") as file:
        _, *rows = csv.reader(file)
    return np.array(rows, float)[:, 1:]
