"""params.yaml is read whole, and every wrong key is named."""

import math
import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from simgap.formats.validation import check
from simgap.types import ConfigError
from tasks import forms, params
from tasks.params import load_params
from tasks.params_sealed import load_sealed
from tasks.ranges import RANGES

ROOT = Path(__file__).parents[2]


def test_the_projects_parameters_are_the_papers() -> None:
    """[Hoffman et al. 2025, Table 1]."""
    train = load_params(ROOT / "params.yaml").train
    assert train.sample_sizes == [1000, 2000, 3000, 4000, 5000]
    assert train.seeds == [0, 1, 2]
    bnn = train.bnn
    assert (bnn.particles, bnn.batch_size, bnn.epochs, bnn.max_training_steps) == (5, 64, 100, 200_000)
    assert (bnn.learning_rate, bnn.weight_decay, bnn.hidden_layer_sizes) == (1e-3, 1e-3, (64, 64, 64))
    assert (bnn.likelihood_exponent, bnn.bandwidth_svgd) == (1.0, 5.0)
    assert (train.fsvgd.lengthscale, train.fsvgd.outputscale, train.fsvgd.measurement_points) == (0.2, 1.0, 16)
    sim = train.sim_fsvgd
    assert (sim.lengthscale, sim.outputscale, sim.measurement_points, sim.function_samples) == (1.0, 0.2, 64, 256)
    fit = train.sim_model
    assert (fit.training_steps, fit.learning_rate, fit.weight_decay) == (10_000, 1e-3, 1e-3)


def test_the_small_size_changes_only_sizes() -> None:
    full = load_params(ROOT / "params.yaml")
    small = load_params(ROOT / "params.yaml", yaml.safe_load((ROOT / "pipelines" / "small.yaml").read_text()))
    assert small.train.fsvgd == full.train.fsvgd
    assert small.train.bnn.learning_rate == full.train.bnn.learning_rate
    assert small.train.bnn.max_training_steps < full.train.bnn.max_training_steps


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ({"train": {"bnn": {"particels": 5}}}, ["train.bnn", "particels", "particles"]),
        ({"train": {"bnn": {"particles": 0}}}, ["train.bnn.particles: ", "greater than or equal to 1; it is 0"]),
        ({"train": {"fsvgd": {"lengthscale": -1.0}}}, ["train.fsvgd.lengthscale: ", "greater than 0; it is -1"]),
        ({"train": {"seeds": ["a"]}}, ["train.seeds.0"]),
        ({"train": {"models": ["gp"]}}, ["train.models.0", "sim_fsvgd"]),
        ({"scores": {}}, ["scores"]),
        ({"score": {"stride": 0}}, ["score.stride"]),
        ({"train": {"workers": 1e9}}, ["train.workers: ", "less than or equal to 1024; it is 1000000000.0"]),
        ({"train": {"bnn": {"hidden_layer_sizes": [64, -64]}}}, ["train.bnn.hidden_layer_sizes.1: ", "it is -64"]),
        ({"policy": {"environment": {"reward": {"arm_value": 2}}}}, ["policy.environment.reward.arm_value: "]),
        ({"policy": {"environment": {"goal_height": [1.0, 0.2]}}}, ["policy.environment: ", "goal_height"]),
        ({"policy": {"environment": {"reward": {"arm": 2}}}}, ["unknown key arm; known are state_bound, "]),
        ({"train": {"workers": True}}, ["train.workers: Input should be a number; it is True"]),
        ({"train": {"seeds": [0, True]}}, ["train.seeds.1: Input should be a number; it is True"]),
        ({"train": {"seeds": [0] * 200_000}}, ["train.seeds: List should have at most 1000 items"]),
        (
            {"train": {"seeds": [*range(1000)], "sample_sizes": [*range(20, 120)]}},
            ["  train: the grid has ", "00,000 cells; it may have 10,000. Give fewer values to try."],
        ),
        (
            {"policy": {"seeds": [*range(1000)], "sample_sizes": [*range(20, 120)]}},
            ["  policy: the grid has 300,000 cells; it may have 10,000."],
        ),
        ({"recordings": {"mine": {"folder": "x", "training": []}}}, ["recordings.mine", "test", "training"]),
    ],
)
def test_wrong_parameters_are_named(override: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(ConfigError) as error:
        load_params(ROOT / "params.yaml", override)
    assert all(word in str(error.value) for word in words), error.value


Leaf = tuple[tuple[str | int, ...], Any]


def leaves(values: Any, path: tuple[str | int, ...] = ()) -> Iterator[Leaf]:
    """Every value of a file that is neither a block nor a list, and where it stands."""
    inner = values.items() if isinstance(values, dict) else enumerate(values) if isinstance(values, list) else None
    if inner is None:
        yield path, values
    else:
        for key, value in inner:
            yield from leaves(value, (*path, key))


def with_another(values: Any, path: tuple[str | int, ...], value: Any) -> Any:
    """The file's values with another one in that place."""
    if not path:
        return value
    changed = values.copy()
    changed[path[0]] = with_another(values[path[0]], path[1:], value)
    return changed


ABSURD = (
    math.inf,
    -math.inf,
    math.nan,
    1e18,
    -1e18,
    "1e18",
    "many",
    None,
    True,
    {"a": 1},
    [[[[1]]]],
    {"a": {"a": {"a": 1}}},
)
LOAD = {"params.yaml": load_params, "pipelines/sealed/params.yaml": load_sealed}


def keys(file: str) -> list[Leaf]:
    """Of the project's file, all that are no text: numbers and switches."""
    found = [leaf for leaf in leaves(yaml.safe_load((ROOT / file).read_text())) if not isinstance(leaf[1], str)]
    assert len(found) > 20
    return found


@pytest.fixture
def _parsed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parsing takes most of the time of a check, and the files do not change."""
    monkeypatch.setattr(params, "read_yaml", cache(params.read_yaml))


@pytest.mark.usefixtures("_parsed_once")
@pytest.mark.parametrize("file", LOAD)
def test_no_number_may_be_absurd(file: str) -> None:
    """Every key refuses what is infinite, huge, of another kind or nested, and says which key it is."""
    values, load = yaml.safe_load((ROOT / file).read_text()), LOAD[file]
    for path, value in keys(file):
        valid = (True,) if isinstance(value, bool) else ()
        for absurd in (a for a in ABSURD if a not in valid):
            with pytest.raises(ConfigError) as error:
                load(ROOT / file, with_another(values, path, absurd))
            assert re.search(rf"^  {'.'.join(map(str, path))}(\.|:)", without_kinds(str(error.value)), re.M), (
                error.value
            )


def without_kinds(message: str) -> str:
    """Of recordings, a message says of which kind of source they would be."""
    return re.sub(r"\.(VirtualParams|FolderParams)", "", message)


@pytest.mark.usefixtures("_parsed_once")
@pytest.mark.parametrize("file", LOAD)
def test_no_size_rate_or_decay_may_be_negative(file: str) -> None:
    """But where a sign has a meaning: places, directions, an entropy."""
    signed = {"rest", "semi_axes", "advance", "shoulder", "body_low", "body_high", "target_entropy"}
    values, load = yaml.safe_load((ROOT / file).read_text()), LOAD[file]
    found = set()
    for path, value in keys(file):
        try:
            load(ROOT / file, with_another(values, path, -abs(value) or -1))
            found.add(next(str(part) for part in reversed(path) if isinstance(part, str)))
        except ConfigError:
            pass
    assert found == (signed if file == "params.yaml" else set())


def test_every_range_is_of_a_key_and_every_key_has_one() -> None:
    names = {str(part) for path, _ in leaves(yaml.safe_load((ROOT / "params.yaml").read_text())) for part in path}
    assert set(RANGES) <= names
    for name, limits in RANGES.items():
        assert limits.keys() & {"ge", "gt"}, name
        assert limits.keys() & {"le", "lt"}, name


@settings(deadline=None)
@given(st.sampled_from(["bnn", "fsvgd", "sim_fsvgd", "sim_model"]), st.data())
def test_the_form_admits_what_the_file_admits(block: str, data: st.DataObject) -> None:
    """Every hyperparameter, whatever number comes."""
    own = yaml.safe_load((ROOT / "params.yaml").read_text())["train"][block]
    key = data.draw(st.sampled_from(sorted(set(own) - {"hidden_layer_sizes"})))
    value = data.draw(st.booleans() | st.integers() | st.floats() | st.floats(-1, 200) | st.integers(-1, 200))

    def admitted(check: Callable[[], object]) -> bool:
        try:
            check()
        except ConfigError:
            return False
        return True

    in_file = admitted(lambda: load_params(ROOT / "params.yaml", {"train": {block: {key: value}}}))
    assert admitted(lambda: check(forms.Hyperparameters, {block: {key: [value]}})) == in_file


def test_parameters_survive_being_written_and_read(tmp_path: Path) -> None:
    params = load_params(ROOT / "params.yaml")
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params.model_dump(mode="json")))
    assert load_params(tmp_path / "params.yaml") == params


def test_a_missing_key_is_named(tmp_path: Path) -> None:
    values = yaml.safe_load((ROOT / "params.yaml").read_text())
    del values["train"]["sim_model"]["learning_rate"]
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(values))
    with pytest.raises(ConfigError, match=r"train\.sim_model\.learning_rate"):
        load_params(tmp_path / "params.yaml")


def test_an_unknown_source_lists_those_there_are() -> None:
    with pytest.raises(ConfigError, match="virtual, spot"):
        load_params(ROOT / "params.yaml").source("moon")
