"""What may be asked for, and what is refused before any work."""

from pathlib import Path
from typing import Any

import pytest

from simgap.formats.validation import check
from simgap.types import ConfigError
from tasks import forms, sweep
from tasks.fingerprint import configuration
from tasks.params import load_params
from tasks.workspace import Cell, Workspace

ROOT = Path(__file__).parents[2]
PARAMS = ROOT / "params.yaml"


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../x", "a/b", "/tmp", ".hidden", "a\0b", "a b", "x" * 101, "-rf", "a.b", "\u212a"]
)
def test_a_name_that_is_no_folder_of_its_own_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=r"the run's name is .* becomes a file or folder"):
        forms.folder(name)


@pytest.mark.parametrize("name", ["v12", "V1", "latest", "Newest"])
def test_an_alias_of_mlflows_own_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="an alias that MLflow uses itself"):
        forms.folder(name)


def test_a_name_is_a_folder_in_sweeps() -> None:
    assert forms.folder("adept-Mole_2") == Path("sweeps/adept-Mole_2")


@pytest.mark.parametrize("path", ["/etc", "..", "data/../../x", "", "a\0b"])
def test_a_path_out_of_the_project_is_refused(path: str) -> None:
    with pytest.raises(ConfigError, match="must lie in the project"):
        forms.inside(path)


def test_recordings_of_overrides_lie_in_the_project_too() -> None:
    outside = {"recordings": {"mine": {"folder": "/etc", "training": ["*"], "test": ["*"]}}}
    with pytest.raises(ConfigError, match="must lie in the project"):
        forms.check_source(load_params(PARAMS, outside), "mine")


@pytest.mark.parametrize(
    ("given", "changes"),
    [
        ({"source": "virtual"}, {}),
        ({"source": "virtual", "session_s": 5.0}, {"recordings": {"virtual": {"session_s": 5.0}}}),
        ({"source": "spot", "training_sessions": 4}, {}),  # the form's own default, for another source
        ({"source": "spot", "folder": "data/x"}, {"recordings": {"spot": {"folder": "data/x"}}}),
    ],
)
def test_recordings_change_the_block_of_their_source(given: dict[str, Any], changes: dict[str, Any]) -> None:
    assert forms.Recordings(**given).overrides(load_params(PARAMS)) == changes


def test_a_folder_for_a_virtual_robot_and_an_unknown_source_are_refused() -> None:
    params = load_params(PARAMS)
    with pytest.raises(ConfigError, match="has no folder"):
        forms.Recordings(source="virtual", folder="data/x").overrides(params)
    with pytest.raises(ConfigError, match="there are virtual, spot"):
        forms.Recordings(source="moon").overrides(params)


def test_the_defaults_are_those_of_params_and_fill_the_form() -> None:
    params = load_params(PARAMS)
    form = check(forms.Hyperparameters, forms.defaults(params, "virtual")["hyperparameters"])
    (only,) = forms.variants(form)
    assert load_params(PARAMS, {"train": forms.nested(only)}) == params


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["learning_rate=1"], "block.name=value"),
        (["bnn.learning_rate"], "block.name=value"),
        (["bnn.learning_rate=2"], "bnn.learning_rate.0: .* less than or equal to 1"),
        (["bnn.learning_rat=0.1"], "bnn.learning_rat: Extra inputs"),
        (["gp.learning_rate=0.1"], "gp: Extra inputs"),
        (["bnn.particles=few"], "bnn.particles.0: .*integer"),
        (["bnn.particles=" + ",".join(["5"] * 1001)], "bnn.particles: List should have at most 1000 items"),
    ],
)
def test_wrong_hyperparameters_are_named(texts: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        forms.read_values(texts)


def test_true_is_no_number() -> None:
    """As in params.yaml."""
    for values in ({"training_sessions": True}, {"session_s": True}):
        with pytest.raises(ConfigError, match=": Input should be a number; it is True"):
            check(forms.Recordings, {"source": "virtual", **values})
    asked = forms.policies(load_params(PARAMS))
    for values in ({"environment_steps": True}, {"learning_rate": True}, {"seeds": [True]}):
        with pytest.raises(ConfigError, match=": Input should be a number; it is True"):
            check(forms.Policies, {**asked, **values})


def test_a_grid_of_too_many_cells_is_refused_before_any_work() -> None:
    """Whether values to try make it so large, or these together with sizes and seeds."""
    values = forms.read_values([f"bnn.{key}={','.join(['0.5'] * 50)}" for key in ("learning_rate", "weight_decay")]
                               + [f"sim_model.learning_rate={','.join(['0.5'] * 50)}"])  # fmt: skip
    with pytest.raises(ConfigError, match="the grid has 125,000 cells; it may have 10,000"):
        forms.variants(values)
    two = forms.read_values(["sim_model.learning_rate=0.1,0.2"])
    only: dict[str, Any] = {"models": ["sim_model"], "noises": ["gaussian"], "sample_sizes": [*range(20, 28)]}
    grid = {"train": {**only, "seeds": [*range(1000)]}}
    with pytest.raises(ConfigError, match="the grid has 16,000 cells; it may have 10,000"):
        sweep.cells(Path("r"), "virtual", two, lambda more: load_params(PARAMS, grid, more))


def test_every_combination_is_a_cell_and_none_is_there_twice() -> None:
    values = forms.read_values(
        ["bnn.learning_rate=0.001,0.01", "bnn.hidden_layer_sizes=16x16,8", "sim_model.weight_decay=0,0.1"]
    )
    only = {"train": {"noises": ["gaussian"], "sample_sizes": [40], "seeds": [0]}}
    cells = sweep.cells(Path("r"), "virtual", values, lambda more: load_params(PARAMS, only, more))
    names = [cell.name + workspace.suffix for workspace, cell in cells]
    assert len(names) == len(set(names)) == 2 + 4 + 4
    assert "sim_model-gaussian-N40-s0-weight_decay=0.1" in names
    assert "fsvgd-gaussian-N40-s0-learning_rate=0.01,hidden_layer_sizes=16x16" in names
    by_name = dict(zip(names, cells.values(), strict=True))
    own = by_name["sim_fsvgd-gaussian-N40-s0-learning_rate=0.01,hidden_layer_sizes=8"]
    assert (own.train.bnn.learning_rate, own.train.bnn.hidden_layer_sizes) == (0.01, (8,))


def test_values_that_differ_little_are_two_cells() -> None:
    """A label with six digits made them one, and the second was never trained."""
    values = forms.read_values(["sim_model.learning_rate=0.00100001,0.00100002"])
    only = {"train": {"models": ["sim_model"], "noises": ["gaussian"], "sample_sizes": [40], "seeds": [0]}}
    cells = sweep.cells(Path("r"), "virtual", values, lambda more: load_params(PARAMS, only, more))
    assert {w.variant for w, _ in cells} == {"learning_rate=0.00100001", "learning_rate=0.00100002"}


def test_a_variant_shares_the_recordings_alone() -> None:
    shared, own = Workspace(Path("r"), "s"), Workspace(Path("r"), "s", "v=1")
    assert (own.recordings, own.transitions) == (shared.recordings, shared.transitions)
    assert own.models == Path("r/v=1/models/s")
    assert shared.models == Path("r/models/s")


def test_the_same_configuration_is_recognised_as_the_same() -> None:
    """Whatever a cell does not depend on; a value that it depends on makes another."""
    cell, params = Cell("gaussian", "fsvgd", 40, 0), load_params(PARAMS).train
    mark = configuration(cell, params)
    for same in ({"seeds": [7]}, {"workers": 9}, {"sim_fsvgd": {"lengthscale": 3.0}}):
        assert configuration(cell, load_params(PARAMS, {"train": same}).train) == mark
    for other in ({"bnn": {"learning_rate": 0.5}}, {"fsvgd": {"lengthscale": 3.0}}):
        assert configuration(cell, load_params(PARAMS, {"train": other}).train) != mark
    assert configuration(cell._replace(seed=1), params) != mark
