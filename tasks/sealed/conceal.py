"""Stage `conceal`: recordings with concealed effects, their keys sealed and the keys' hashes published."""

import hashlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from prefect import task

from concealed import seal, sessions, spikes, suite
from concealed.case import Recipe, conceal
from concealed.catalogue import FORMS
from concealed.kinds import case as kinds
from concealed.kinds.suite import recipes as recipes_of_kinds
from simgap.formats.documents import write_bytes, write_json
from simgap.formats.folders import remove_file, remove_folder
from simgap.formats.recordings import read_recordings
from simgap.simulators.spot import SCHEMA
from simgap.types import SimgapError
from tasks.params import FolderParams
from tasks.params_sealed import ArmParams, ConcealParams, KindsParams, TiesParams
from tasks.sealed.ties import ties
from tasks.sealed.workspace import AFTER, BEFORE, EXAMINATION, SUITES, SealedWorkspace

ROWS, PIECES = 241, 8
"""Of a real robot's recordings: rows of a piece, and pieces before and after."""
SALT_BYTES = 16


def seed_of(suite_name: str, params: ConcealParams, code: str) -> list[int]:
    """What all that is drawn comes from: a seed to work with, or the hash of the diagnosing code and the round."""
    if suite_name != EXAMINATION:
        return [SUITES.index(suite_name), params.seed]
    mark = hashlib.sha256(f"{code} round {params.round}".encode()).hexdigest()
    return [1, *(int(mark[i : i + 8], 16) for i in range(0, 64, 8))]


class Made(NamedTuple):
    """A case before it has a name: a place in the parts, and what writes its recordings and returns its key."""

    part: int
    write: Callable[[Path], dict[str, Any]]


Real = Callable[[], Sequence[tuple[np.ndarray, np.ndarray]]]
"""Reads sessions of a real robot: states and commands."""


@task(task_run_name="conceal-{workspace.suite}")
def write(
    workspace: SealedWorkspace, params: ConcealParams, code: str, real: Real, report: Callable[[int, dict], None]
) -> dict[str, Any]:
    """Write all cases, then the keys, then the manifest, which is returned; `code`: digest of the diagnosing code."""
    seeds = np.random.SeedSequence(seed_of(workspace.suite, params, code)).spawn(4)
    draw, name_draw, salt_draw, case_draw = (np.random.default_rng(s) for s in seeds)
    match workspace.suite:
        case "engine":
            made = _engine(draw, case_draw)
        case "real":
            made = _real(draw, case_draw, real())
        case "arm":
            made = _arm(params.arm, draw, case_draw)
        case "kinds":
            made = _kinds(params.kinds, draw, case_draw)
        case "ties":
            made = _ties(workspace.root, params.ties, case_draw)
        case name:
            made = _suite(params, name, draw, case_draw)
    remove_file(workspace.manifest, workspace.root)  # first and last: without it there is no suite, whole or in part
    for folder in (workspace.data, workspace.keys):
        remove_folder(folder, workspace.root)
    names = suite.names(len(made), name_draw)
    keys: dict[str, dict[str, Any]] = {}
    # In the order of the names, so that the order of making says nothing.
    for name, case in sorted(zip(names, made, strict=True)):
        keys[name] = case.write(workspace.case(name))
        report(len(keys), {})
    salts = {name: salt_draw.bytes(SALT_BYTES).hex() for name in keys}
    secret = seal.secret()
    write_bytes(workspace.sealed, seal.seal(keys, salts, secret))
    write_bytes(workspace.secret, secret, private=True)
    parts: list[list[str]] = [[] for _ in range(max(case.part for case in made) + 1)]
    for name, case in zip(names, made, strict=True):
        parts[case.part].append(name)
    manifest = {
        "schema": 1, "suite": workspace.suite, "round": params.round, "code": code, "parts": parts,
        "keys": {name: seal.digest(key, salts[name]) for name, key in keys.items()},
    }  # fmt: skip
    write_json(workspace.manifest, manifest)
    write_json(workspace.published, manifest)
    return manifest


def read_real(source: FolderParams) -> list[tuple[np.ndarray, np.ndarray]]:
    """Sessions of a real Spot; RecordingError where there are none."""
    patterns = [*source.training, *source.test]
    found, _ = read_recordings(source.folder, SCHEMA, 1 / 15, patterns)
    return [(r.state, r.command) for r in found]


def _made(
    parts: Sequence[Sequence[Any]], write: Callable[[Any, int, Path], dict[str, Any]], case_draw: np.random.Generator
) -> list[Made]:
    """A case of each recipe, with a seed of its own. write: of a recipe, a seed and a folder."""
    seeds = iter(case_draw.integers(2**62, size=sum(map(len, parts))).tolist())
    return [Made(p, partial(write, recipe, next(seeds))) for p, part in enumerate(parts) for recipe in part]


def _suite(params: ConcealParams, name: str, draw: np.random.Generator, case_draw: np.random.Generator) -> list[Made]:
    """Cases of the development suite and of examinations."""

    def write(recipe: Recipe, seed: int, folder: Path) -> dict[str, Any]:
        case = conceal(recipe, seed)
        sessions.write(folder, case.measured, case.command)
        return case.key

    suite.known(params.effects)
    parts = suite.recipes(_config(params), name == EXAMINATION, draw)
    return _made(parts, write, case_draw)


def _engine(draw: np.random.Generator, case_draw: np.random.Generator) -> list[Made]:
    """Every cause in the physics engine, small and large, and twice nothing."""
    from concealed import engine  # brings the engine along, which no other suite needs

    def write(cause: str | None, large: bool, seed: int, folder: Path) -> dict[str, Any]:
        case = engine.conceal(cause, large, np.random.default_rng(seed))
        for name, recorded in ((BEFORE, case.before), (AFTER, case.after)):
            sessions.write(folder / name, recorded.measured, recorded.command)
        return case.key

    causes = [(cause, large) for cause in (None, *engine.CAUSES) for large in (False, True)]
    order = [causes[i] for i in draw.permutation(len(causes))]
    return [Made(0, partial(write, *what, int(case_draw.integers(2**62)))) for what in order]


def _real(
    draw: np.random.Generator, case_draw: np.random.Generator, recorded: Sequence[tuple[np.ndarray, np.ndarray]]
) -> list[Made]:
    """Every spike in recordings of a real robot, and twice nothing."""
    pieces = [(x[i : i + ROWS], u[i : i + ROWS]) for x, u in recorded for i in range(0, len(x) - ROWS + 1, ROWS)]
    if len(pieces) < 2 * PIECES:
        raise SimgapError(
            f"the recordings of a real robot must give {2 * PIECES} pieces of {ROWS} rows, not {len(pieces)}"
        )

    def spike(what: str | None, seed: int, folder: Path) -> dict[str, Any]:
        chosen = [pieces[i] for i in np.random.default_rng(seed).permutation(len(pieces))]
        before = chosen[:PIECES]
        after, key = spikes.conceal(what, before, chosen[PIECES : 2 * PIECES])
        for name, pairs in ((BEFORE, before), (AFTER, after)):
            sessions.write(folder / name, np.stack([x for x, _ in pairs]), np.stack([u for _, u in pairs]))
        return key

    order = [[None, None, *spikes.SPIKES][i] for i in draw.permutation(len(spikes.SPIKES) + 2)]
    return [Made(0, partial(spike, what, int(case_draw.integers(2**62)))) for what in order]


def _arm(params: ArmParams, draw: np.random.Generator, case_draw: np.random.Generator) -> list[Made]:
    """Arms with every cause, three joints and six, with velocities and without, and nulls."""
    from concealed.arms import case  # brings the engine along
    from concealed.arms.causes import CAUSES
    from concealed.arms.suite import recipes

    def write(recipe: case.Recipe, seed: int, folder: Path) -> dict[str, Any]:
        made = case.conceal(recipe, params.sessions, params.rows, seed)
        sessions.write(folder, made.measured, made.command, made.columns, made.model)
        return made.key

    unknown = [cause for cause in params.causes if cause not in CAUSES]
    if unknown or not params.nulls + params.repeats:
        raise SimgapError(f"conceal.arm.causes: no arm has {', '.join(unknown)}; there are {', '.join(CAUSES)}."
                          if unknown else "conceal.arm: there must be a case; ask for nulls or repeats.")  # fmt: skip
    parts = recipes(params.nulls, params.repeats, params.causes, params.parts, draw)
    return _made(parts, write, case_draw)


def _kinds(params: KindsParams, draw: np.random.Generator, case_draw: np.random.Generator) -> list[Made]:
    """Machines of every kind with every cause that it may have, and nulls."""

    def write(recipe: kinds.Recipe, seed: int, folder: Path) -> dict[str, Any]:
        made = kinds.conceal(recipe, params.sessions, params.rows, seed)
        sessions.write(folder, made.measured, made.command, made.machine.columns, simulator=made.machine.simulator)
        return made.key

    if not params.nulls + params.repeats:
        raise SimgapError("conceal.kinds: there must be a case; ask for nulls or repeats.")
    parts = recipes_of_kinds(params.nulls, params.repeats, params.parts, draw)
    return _made(parts, write, case_draw)


def _ties(root: Path, params: TiesParams, case_draw: np.random.Generator) -> list[Made]:
    """The ties of another suite, each with the experiment that its diagnosis prescribed."""
    other = SealedWorkspace(root, params.of)
    return [
        Made(0, partial(tie.conceal, other.recordings(tie.case), params.repeats, int(case_draw.integers(2**62))))
        for tie in ties(root, params)
    ]


def _config(params: ConcealParams) -> suite.Config:
    values = params.model_dump(exclude={"seed", "round", "real", "arm", "kinds", "ties"})
    values = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
    return suite.Config(**{**values, "effects": values["effects"] or tuple(FORMS)})
