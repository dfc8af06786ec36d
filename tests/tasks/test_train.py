"""What identifies a cell, and what does not."""

import dataclasses
from pathlib import Path

from tasks import train
from tasks.fingerprint import (
    AUGMENTED,
    DIAGNOSIS,
    POLICY,
    POLICY_RESIDUAL,
    RESIDUAL,
    TRAINING,
    Codes,
    code_digest,
    codes,
    fingerprint,
    modules_of,
)
from tasks.params import load_params
from tasks.workspace import Cell, Share, Workspace

PARAMS = load_params(Path(__file__).parents[2] / "params.yaml").train
CELL = Cell("gaussian", "fsvgd", 1000, 0)


def mark(cell: Cell = CELL, data: str = "d", **changes) -> str:
    bnn = {k: v for k, v in changes.items() if k != "code"}
    params = PARAMS.model_copy(update={"bnn": type(PARAMS.bnn)(**{**vars(PARAMS.bnn), **bnn})})
    return fingerprint(cell, data, 1 / 15, params, changes.get("code", "c"))


def test_fingerprint_changes_with_what_the_result_depends_on() -> None:
    assert mark() == mark()
    changed = [mark(cell=CELL._replace(seed=1)), mark(data="e"), mark(learning_rate=2e-3), mark(code="x")]
    assert len({mark(), *changed}) == 5


def test_sim_models_fingerprint_ignores_the_networks() -> None:
    sim = CELL._replace(model="sim_model")
    assert mark(cell=sim) == mark(cell=sim, learning_rate=2e-3)


def test_code_of_training_is_what_learning_imports() -> None:
    names = {path.stem for path in modules_of(TRAINING)}
    assert {"learn", "fsvgd", "identify", "priors", "networks", "noise", "recordings", "spot", "domain"} <= names
    assert not names & {"scores", "virtual_spot", "operator", "types"}
    assert code_digest(TRAINING) == code_digest(TRAINING)


def test_code_of_the_diagnosis_makes_no_other_model_stale() -> None:
    """What the paper's models compute does not depend on it."""
    diagnosis = [path for path in modules_of(DIAGNOSIS) if {"diagnosis", "effects"} & set(path.parts)]
    effects = [path for path in diagnosis if "effects" in path.parts]
    assert len(diagnosis) > len(effects) > 5
    assert not set(diagnosis) & set(modules_of(TRAINING))
    assert set(modules_of(TRAINING)) | set(effects) <= set(modules_of(AUGMENTED))
    assert not (set(diagnosis) - set(effects)) & set(modules_of(AUGMENTED))
    assert len(set(codes())) == 4


def test_the_code_of_the_residual_makes_no_other_model_or_policy_stale() -> None:
    residual = [path for path in modules_of(RESIDUAL) if path.parent.name == "residual"]
    assert {"learn", "fit", "train", "model", "pace"} <= {path.stem for path in residual}
    for others in (TRAINING, AUGMENTED, DIAGNOSIS, POLICY):
        assert not set(residual) & set(modules_of(others))
    assert set(modules_of(POLICY)) | {path for path in residual if path.stem == "model"} <= set(
        modules_of(POLICY_RESIDUAL)
    )
    made = Codes("training", "augmented", "residual", "diagnosis")
    models = {"fsvgd": "training", "sim_model_diagnosed": "augmented", "residual_diagnosed": "residual"}
    assert {model: made.of(CELL._replace(model=model)) for model in models} == models


def test_only_a_residuals_fingerprint_holds_its_hyperparameters() -> None:
    other = PARAMS.model_copy(update={"residual": dataclasses.replace(PARAMS.residual, durations=3)})
    for model, same in (("sim_model_diagnosed", True), ("sim_fsvgd", True), ("residual_diagnosed", False)):
        cell = CELL._replace(model=model)
        marks = [fingerprint(cell, "d", 1 / 15, params, "c") for params in (PARAMS, other)]
        assert (marks[0] == marks[1]) == same


def test_a_diagnosed_cells_fingerprint_holds_its_diagnosis() -> None:
    diagnosed = CELL._replace(model="sim_fsvgd_diagnosed")
    assert (diagnosed.method, diagnosed.share) == ("sim_fsvgd", Share(1000, 0))
    assert (CELL.method, CELL.share) == ("fsvgd", None)
    marks = {fingerprint(diagnosed, "d", 1 / 15, PARAMS, "c", found) for found in ("one", "another", None)}
    assert len(marks) == 3


def test_the_grid_has_every_cell_once_longest_first() -> None:
    models = ["sim_model", "fsvgd", "sim_fsvgd", "sim_model_diagnosed", "sim_fsvgd_diagnosed", "residual_diagnosed"]
    cells = train.grid(PARAMS.model_copy(update={"models": models}))
    assert len(cells) == len(set(cells)) == 6 * 2 * 5 * 3
    assert [cell.sample_size for cell in cells] == sorted((c.sample_size for c in cells), reverse=True)


def test_cells_that_left_the_grid_leave_the_folder(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path, "virtual")
    old = CELL._replace(sample_size=10)
    diagnosed = CELL._replace(model="sim_model_diagnosed")
    for cell in (CELL, old, diagnosed):
        workspace.model(cell).parent.mkdir(parents=True, exist_ok=True)
        workspace.model(cell).touch()
        workspace.record(cell).touch()
    for share in (Share(1000, 0), Share(1000, 1)):
        workspace.augmented(share).touch()
        workspace.effects(share).touch()
    train.remove_stale(workspace, [CELL, diagnosed])
    left = {workspace.model(CELL), workspace.record(CELL), workspace.model(diagnosed), workspace.record(diagnosed)}
    left |= {workspace.augmented(Share(1000, 0)), workspace.effects(Share(1000, 0))}
    assert set(workspace.models.iterdir()) == left
