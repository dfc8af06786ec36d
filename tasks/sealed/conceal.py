"""Stage `conceal`: recordings with concealed effects, their keys sealed and the keys' hashes published."""

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
from prefect import task

from concealed import seal, sessions, suite
from concealed.case import conceal
from concealed.catalogue import FORMS
from tasks import files
from tasks.params import ConcealParams
from tasks.sealed.workspace import SealedWorkspace

DEVELOPMENT, EXAMINATION = "development", "examination"
SALT_BYTES = 16


def seed_of(suite_name: str, params: ConcealParams, code: str) -> list[int]:
    """What all that is drawn comes from: a seed to work with, or the hash of the diagnosing code and the round."""
    if suite_name != EXAMINATION:
        return [0, params.seed]
    mark = hashlib.sha256(f"{code} round {params.round}".encode()).hexdigest()
    return [1, *(int(mark[i : i + 8], 16) for i in range(0, 64, 8))]


@task(task_run_name="conceal-{workspace.suite}")
def write(
    workspace: SealedWorkspace, params: ConcealParams, code: str, report: Callable[[int, dict[str, float]], None]
) -> dict[str, Any]:
    """Write all cases, then the keys, then the manifest, which is returned; `code`: digest of the diagnosing code."""
    for folder in (workspace.data, workspace.keys):
        files.remove_folder(folder)
    draw, name_draw, salt_draw, case_draw = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed_of(workspace.suite, params, code)).spawn(4)
    )
    suite.known(params.effects)
    parts = suite.recipes(_config(params), workspace.suite == EXAMINATION, draw)
    count = sum(len(part) for part in parts)
    names = iter(suite.names(count, name_draw))
    found = [[(next(names), recipe) for recipe in part] for part in parts]
    keys: dict[str, dict[str, Any]] = {}
    # In the order of the names, so that the order of making says nothing.
    for name, recipe in sorted(case for part in found for case in part):
        case = conceal(recipe, int(case_draw.integers(2**62)))
        sessions.write(workspace.cases / name, case.measured, case.command)
        keys[name] = case.key
        report(len(keys), {})
    salts = {name: salt_draw.bytes(SALT_BYTES).hex() for name in keys}
    secret = seal.secret()
    files.write_bytes(workspace.sealed, seal.seal(keys, salts, secret))
    files.write_bytes(workspace.secret, secret, private=True)
    manifest = {
        "schema": 1, "suite": workspace.suite, "round": params.round, "code": code,
        "parts": [[name for name, _ in part] for part in found],
        "keys": {name: seal.digest(key, salts[name]) for name, key in keys.items()},
    }  # fmt: skip
    files.write_json(workspace.manifest, manifest)
    files.write_json(workspace.published, manifest)
    return manifest


def _config(params: ConcealParams) -> suite.Config:
    values = params.model_dump(exclude={"seed", "round"})
    values = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
    return suite.Config(**{**values, "effects": values["effects"] or tuple(FORMS)})
