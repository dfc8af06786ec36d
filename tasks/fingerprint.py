"""What a trained cell's result depends on, as one short mark: equal marks, equal results."""

import ast
import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import simgap
from tasks.params import Params, TrainParams
from tasks.workspace import Cell, Share, TwinShare

TRAINING = ("simgap.learn",)
"""Where the code of training begins."""
AUGMENTED = (*TRAINING, "simgap.simulators.augmented")
"""The same for models that are given a diagnosed simulator."""
RESIDUAL = (*AUGMENTED, "simgap.residual.learn")
"""The same where the residual is learnt."""
DIAGNOSIS = ("simgap.diagnosis.inference.explain",)
"""Where the code that finds effects begins."""
TWIN = ("simgap.robots.twin.score", "simgap.robots.twin.fit", "simgap.simulators.augmented", "simgap.scores", *TRAINING)
"""Where the code begins that makes a twin of a diagnosed simulator, and compares it with models."""
WHOLE_DIAGNOSIS = ("simgap.diagnosis.diagnose", "simgap.simulators.spot")
"""Where the code that an examination examines begins."""
MODEL_DIAGNOSIS = ("simgap.diagnosis.diagnose", "simgap.loading.model_files", "simgap.simulators.mujoco.account")
"""The same of an examination on machines of which there is a model file."""
POLICY = ("simgap.policies.learn", "simgap.policies.environment", "simgap.policies.actor")
"""Where the code that learns a policy begins."""
POLICY_RESIDUAL = (*POLICY, "simgap.policies.residual_spot")
"""The same in a model with a residual."""


class Codes(NamedTuple):
    """Digests of the code of training, with a diagnosed simulator, with a residual; and of the diagnosis."""

    training: str
    augmented: str
    residual: str
    diagnosis: str

    def of(self, cell: Cell) -> str:
        """Of what trains the cell."""
        return self.residual if cell.method == "residual" else self.augmented if cell.share else self.training


def codes() -> Codes:
    """Call it before tasks fan out: the parser of Python 3.11 does not bear several threads."""
    return Codes(*map(code_digest, (TRAINING, AUGMENTED, RESIDUAL, DIAGNOSIS)))


def fingerprint(
    cell: Cell, data_digest: str, time_step: float, params: TrainParams, code: str, diagnosis: str | None = None
) -> str:
    """Identifies what a cell's result depends on: the data, its share of the parameters, and the code.

    `diagnosis`: the fingerprint of the cell's diagnosis, where it has one.
    """
    relevant = {
        "cell": cell,
        "data": data_digest,
        "time_step": time_step,
        "params": relevant_params(cell, params),
        "code": code,
    }
    return _mark(relevant if diagnosis is None else {**relevant, "diagnosis": diagnosis})


def configuration(cell: Cell, params: TrainParams) -> str:
    """Identifies what was asked for, the cell and its share of the parameters, whatever the data and the code."""
    return _mark({"cell": cell, "params": relevant_params(cell, params)})


def configuration_of_policy(cell: Cell, params: Params) -> str:
    """The same for a policy."""
    return _mark({"cell": cell, "params": relevant_policy_params(params)})


def configuration_of_diagnosis(simulator: str, folders: Sequence[Path | None], seed: int) -> str:
    """The same for a diagnosis, of a simulator by its name and of recordings by their folders."""
    return _mark({"simulator": simulator, "folders": [str(folder) for folder in folders], "seed": seed})


def of_diagnosis(share: Share | TwinShare, data_digest: str, time_step: float, code: str) -> str:
    """Identifies what the diagnosis of a share of the recordings depends on."""
    return _mark({"share": share, "data": data_digest, "time_step": time_step, "code": code})


def of_policy(cell: Cell, model: str, data_digest: str, params: Params, code: str) -> str:
    """Identifies what a policy depends on; `model`: the fingerprint of the model it learns in."""
    relevant = {"model": model, "data": data_digest, "params": relevant_policy_params(params), "code": code}
    return _mark({"cell": cell, **relevant})


def of_twin(data_digest: str, params: Params, code: str, diagnosis: str) -> str:
    """Identifies what a twin and its scores depend on; `diagnosis`: the fingerprint of that of its sessions."""
    blocks = {"twin": params.twin, "score": params.score, "transitions": params.transitions}
    models = {name: asdict(getattr(params.train, name)) for name in ("residual", "bnn", "sim_model", "fsvgd")}
    relevant = {**{name: block.model_dump(mode="json") for name, block in blocks.items()}, **models}
    return _mark({"data": data_digest, "params": relevant, "code": code, "diagnosis": diagnosis})


def relevant_policy_params(params: Params) -> dict[str, Any]:
    """The share of the parameters that a policy depends on."""
    own = {name: asdict(getattr(params.policy, name)) for name in ("environment", "learning", "sac")}
    bounds = params.episode_bounds
    return own if bounds is None else {**own, "bounds": asdict(bounds)}


def _mark(relevant: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(relevant, sort_keys=True).encode()).hexdigest()[:16]


def relevant_params(cell: Cell, params: TrainParams) -> dict[str, Any]:
    """The share of the parameters that a cell's result depends on."""
    if cell.method == "sim_model":
        return asdict(params.sim_model)
    if cell.method == "residual":
        return {**asdict(params.bnn), "residual": asdict(params.residual)}
    prior = params.fsvgd if cell.method == "fsvgd" else params.sim_fsvgd
    return {**asdict(params.bnn), "prior": asdict(prior)}


@cache
def diagnosing_code(model_file: bool) -> str:
    """Digest of all the code that an examination examines, of the Spot's model or of model files, made once a process:
    call it before a flow begins, whose threads the parser of Python 3.11 does not bear."""
    return code_digest(MODEL_DIAGNOSIS if model_file else WHOLE_DIAGNOSIS)


def modules_of(roots: Sequence[str]) -> list[Path]:
    """The modules of `simgap` that these run, by their imports."""
    package = Path(simgap.__file__).parent
    names = {package / "__init__.py", package / "types.py"}  # what things are called, not what they compute
    found: dict[Path, None] = {}
    queue = list(roots)
    while queue:
        path = _source(queue.pop())
        if path is None or path in found or path in names:
            continue
        found[path] = None
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                queue += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return sorted(found)


def code_digest(roots: Sequence[str]) -> str:
    """Digest of the modules that these run as the interpreter sees them, comments and docstrings apart."""
    trees = []
    for path in modules_of(roots):
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
                node.body = [s for s in node.body if not _is_docstring(s)]
        trees.append((path.name, ast.dump(tree)))
    return hashlib.sha256(json.dumps(trees).encode()).hexdigest()


def _is_docstring(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _source(module: str) -> Path | None:
    """The file of a module of `simgap`; None for anything else, such as a name imported from a module."""
    package, *parts = module.split(".")
    if package != simgap.__name__:
        return None
    path = Path(simgap.__file__).parent.joinpath(*parts)
    for candidate in (path / "__init__.py", path.with_suffix(".py")):
        if candidate.is_file():
            return candidate
    return None
