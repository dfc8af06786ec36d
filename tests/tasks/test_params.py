"""params.yaml is read whole, and every wrong key is named."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from simgap.types import ConfigError
from tasks.params import load_params

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
    small = load_params(ROOT / "params.yaml", yaml.safe_load((ROOT / "small.yaml").read_text()))
    assert small.train.fsvgd == full.train.fsvgd
    assert small.train.bnn.learning_rate == full.train.bnn.learning_rate
    assert small.train.bnn.max_training_steps < full.train.bnn.max_training_steps


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ({"train": {"bnn": {"particels": 5}}}, ["train.bnn", "particels", "particles"]),
        ({"train": {"bnn": {"particles": 0}}}, ["train.bnn", "particles is 0"]),
        ({"train": {"fsvgd": {"lengthscale": -1.0}}}, ["train.fsvgd", "lengthscale is -1"]),
        ({"train": {"seeds": ["a"]}}, ["train.seeds.0"]),
        ({"train": {"models": ["gp"]}}, ["train.models.0", "sim_fsvgd"]),
        ({"scores": {}}, ["scores"]),
        ({"score": {"stride": 0}}, ["score.stride"]),
        ({"recordings": {"mine": {"folder": "x", "training": []}}}, ["recordings.mine", "test", "training"]),
    ],
)
def test_wrong_parameters_are_named(override: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(ConfigError) as error:
        load_params(ROOT / "params.yaml", override)
    assert all(word in str(error.value) for word in words), error.value


def test_a_missing_key_is_named(tmp_path: Path) -> None:
    values = yaml.safe_load((ROOT / "params.yaml").read_text())
    del values["train"]["sim_model"]["learning_rate"]
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(values))
    with pytest.raises(ConfigError, match=r"train\.sim_model\.learning_rate"):
        load_params(tmp_path / "params.yaml")


def test_an_unknown_source_lists_those_there_are() -> None:
    with pytest.raises(ConfigError, match="virtual, spot"):
        load_params(ROOT / "params.yaml").source("moon")
