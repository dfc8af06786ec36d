"""params.yaml, read once into typed, frozen configurations; an unknown, missing or impossible key is named."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from simgap import fsvgd, identify, priors
from simgap.types import ConfigError

ModelName = Literal["sim_model", "fsvgd", "sim_fsvgd", "sim_model_diagnosed", "sim_fsvgd_diagnosed"]
NoiseName = Literal["gaussian", "student_t"]
Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]


def _known_keys(config: type) -> Callable[[Any], Any]:
    """A dataclass of `simgap` ignores unknown keys when validated; here they are refused."""
    names = {f.name for f in dataclasses.fields(config)}

    def check(value: Any) -> Any:
        if isinstance(value, Mapping) and set(value) - names:
            raise ValueError(
                f"unknown key {', '.join(sorted(set(value) - names))}; known are {', '.join(sorted(names))}"
            )
        return value

    return check


class _Block(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class VirtualParams(_Block):
    """Sessions of the virtual Spot."""

    training_sessions: Count = Field(description="Sessions to draw training transitions from.")
    test_sessions: Count = Field(description="Sessions held out for scores.")
    session_s: Positive = Field(description="Length of a session [s].")
    seed: int = Field(ge=0, description="Seed of robot, operator and noise.")


class FolderParams(_Block):
    """A folder of recordings; glob patterns say which sessions train and which test."""

    folder: Path = Field(description="Folder of the recording set, absolute or from the project's root.")
    training: list[str] = Field(min_length=1, description="Glob patterns of training sessions.")
    test: list[str] = Field(min_length=1, description="Glob patterns of test sessions.")


class TransitionsParams(_Block):
    nominal_rate_hz: Positive = Field(description="Rows per second where time stamps are absent.")


class TrainParams(_Block):
    models: list[ModelName] = Field(min_length=1)
    noises: list[NoiseName] = Field(min_length=1, description="Families of the learned likelihood.")
    sample_sizes: list[Annotated[int, Field(ge=20)]] = Field(min_length=1, description="N, transitions to learn from.")
    seeds: list[Annotated[int, Field(ge=0)]] = Field(min_length=1)
    workers: Count = Field(description="Cells trained side by side.")
    bnn: Annotated[fsvgd.Config, BeforeValidator(_known_keys(fsvgd.Config))]
    sim_model: Annotated[identify.Config, BeforeValidator(_known_keys(identify.Config))]
    fsvgd: Annotated[priors.Config, BeforeValidator(_known_keys(priors.Config))]
    sim_fsvgd: Annotated[priors.SimulatorConfig, BeforeValidator(_known_keys(priors.SimulatorConfig))]


class ScoreParams(_Block):
    horizons: list[Count] = Field(min_length=1, description="Steps of rollout.")
    stride: Count = Field(description="Rows between starts of rollouts.")


class ReportParams(_Block):
    figure_dpi: Count


class DiagnoseParams(_Block):
    seed: int = Field(ge=0, description="Seed of what is drawn: resampled sessions, simulated data, the black box.")


class Params(_Block):
    """The whole of params.yaml."""

    recordings: dict[str, VirtualParams | FolderParams] = Field(min_length=1)
    transitions: TransitionsParams
    train: TrainParams
    score: ScoreParams
    report: ReportParams
    diagnose: DiagnoseParams

    def source(self, name: str) -> VirtualParams | FolderParams:
        """The recordings block of that name, or a ConfigError that lists those there are."""
        if name not in self.recordings:
            raise ConfigError(
                f"params.yaml has no block recordings.{name}; there are {', '.join(self.recordings)}. "
                "Add one, with the keys folder, training and test."
            )
        return self.recordings[name]


def _merge(base: Any, overrides: Any) -> Any:
    if not (isinstance(base, dict) and isinstance(overrides, dict)):
        return overrides
    return {key: _merge(base[key], overrides[key]) if key in base and key in overrides else {**base, **overrides}[key]
            for key in {**base, **overrides}}  # fmt: skip


def load_params(path: Path, *overrides: Mapping[str, Any]) -> Params:
    """`path` with `overrides` merged in, block by block; ConfigError names every key that is wrong."""
    try:
        values = yaml.safe_load(path.read_text())
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}).") from None
    for override in overrides:
        values = _merge(values, dict(override))
    try:
        return Params.model_validate(values)
    except ValidationError as error:
        lines = [f"  {'.'.join(str(part) for part in e['loc'])}: {e['msg']}" for e in error.errors()]
        raise ConfigError(f"{path}: {len(lines)} values are wrong:\n" + "\n".join(lines)) from None
