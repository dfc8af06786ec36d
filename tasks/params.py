"""params.yaml, read once into typed, frozen configurations; an unknown, missing or impossible key is named."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError, model_validator

from simgap import fsvgd, identify, priors
from simgap.formats.validation import explained
from simgap.formats.yaml_files import read_yaml
from simgap.policies import environment, learn, references, sac
from simgap.policies.bounds import Bounds
from simgap.residual import config
from simgap.robots.twin import config as twin
from simgap.types import ConfigError
from tasks import names
from tasks.ranges import (
    MOST_VALUES,
    Dpi,
    Gain,
    Metres,
    Name,
    Ranged,
    Rate,
    SampleSize,
    Seed,
    SessionLength,
    Sessions,
    Speed,
    Steps,
    Strict,
    Workers,
    check_cells,
)

ModelName = Literal[
    "sim_model", "fsvgd", "sim_fsvgd", "sim_model_diagnosed", "sim_fsvgd_diagnosed", "residual_diagnosed"
]
NoiseName = Literal["gaussian", "student_t"]
_Some = Field(min_length=1, max_length=MOST_VALUES)
Models = Annotated[list[ModelName], _Some]
Noises = Annotated[list[NoiseName], _Some]
SampleSizes = Annotated[list[SampleSize], _Some]
Seeds = Annotated[list[Seed], _Some]
_Model = TypeVar("_Model", bound=BaseModel)


class VirtualParams(Strict):
    """Sessions of the virtual Spot."""

    training_sessions: Sessions = Field(description="Sessions to draw training transitions from.")
    test_sessions: Sessions = Field(description="Sessions held out for scores.")
    session_s: SessionLength = Field(description="Length of a session [s].")
    seed: Seed = Field(description="Seed of robot, operator and noise.")


class FolderParams(Strict):
    """A folder of recordings; glob patterns say which sessions train and which test."""

    folder: Path = Field(description="Folder of the recording set, absolute or from the project's root.")
    training: list[str] = Field(min_length=1, description="Glob patterns of training sessions.")
    test: list[str] = Field(min_length=1, description="Glob patterns of test sessions.")
    further: list[str] = Field(default=[], description="Glob patterns of sessions for the robot's twin alone.")


class TransitionsParams(Strict):
    nominal_rate_hz: Rate = Field(description="Rows per second where time stamps are absent.")


class TrainParams(Strict):
    models: Models
    noises: Noises = Field(description="Families of the learned likelihood.")
    sample_sizes: SampleSizes = Field(description="N, transitions to learn from.")
    seeds: Seeds
    workers: Workers = Field(description="Cells trained side by side.")
    bnn: Annotated[fsvgd.Config, Ranged()]
    sim_model: Annotated[identify.Config, Ranged()]
    fsvgd: Annotated[priors.Config, Ranged()]
    sim_fsvgd: Annotated[priors.SimulatorConfig, Ranged()]
    residual: Annotated[config.Config, Ranged()]

    @model_validator(mode="after")
    def _few_cells(self) -> "TrainParams":
        check_cells(*map(len, (self.models, self.noises, self.sample_sizes, self.seeds)))
        return self


class ScoreParams(Strict):
    horizons: list[Steps] = Field(min_length=1, max_length=MOST_VALUES, description="Steps of rollout.")
    stride: Steps = Field(description="Rows between starts of rollouts.")


class ReportParams(Strict):
    figure_dpi: Dpi


class PolicyParams(Strict):
    noise: NoiseName = Field(description="Family of the likelihood of the models that policies learn in.")
    models: Models
    sample_sizes: SampleSizes = Field(description="N, of the models.")
    seeds: Seeds
    workers: Workers = Field(description="Policies learnt side by side.")
    environment: Annotated[environment.Config, Ranged()]
    learning: Annotated[learn.Config, Ranged()]
    sac: Annotated[sac.Config, Ranged()]

    @model_validator(mode="after")
    def _few_cells(self) -> "PolicyParams":
        check_cells(*map(len, (self.models, self.sample_sizes, self.seeds)))
        return self


class TwinParams(Strict):
    """A robot that stands in for a recorded one."""

    seed: Seed = Field(description="Seed of its fit and of its diagnosis.")
    fit: Annotated[twin.Config, Ranged()]


class ProportionalParams(Strict):
    """What policies are compared with, a controller for every gain."""

    gains: list[Gain] = Field(max_length=MOST_VALUES, description="Of the hand [1/s].")
    base_gain: Gain = Field(description="Of the base [1/s].")
    rest: tuple[Metres, Metres, Metres] = Field(description="Where the base would have the hand, in its frame [m].")


class TrackParams(Strict):
    seed: Seed = Field(description="Seed of the robot's noise.")
    robot_limit: tuple[Speed, Speed, Speed, Speed, Speed, Speed] = Field(
        description="Greatest commands that the robot admits [m/s, rad/s]."
    )
    ellipse: Annotated[references.Ellipse, Ranged()]
    helix: Annotated[references.Helix, Ranged()]
    bounds: Annotated[Bounds, Ranged()]
    proportional: ProportionalParams


class DiagnoseParams(Strict):
    seed: Seed = Field(description="Seed of what is drawn: resampled sessions, simulated data, the black box.")


class Params(Strict):
    """The whole of params.yaml."""

    recordings: dict[Name, VirtualParams | FolderParams] = Field(min_length=1)
    transitions: TransitionsParams
    train: TrainParams
    score: ScoreParams
    report: ReportParams
    policy: PolicyParams
    twin: TwinParams
    track: TrackParams
    diagnose: DiagnoseParams

    @property
    def episode_bounds(self) -> Bounds | None:
        """Where an episode of a policy that learns is lost as a run on the robot is stopped; None for nowhere."""
        return self.track.bounds if self.policy.environment.stopped else None

    def source(self, name: str) -> VirtualParams | FolderParams:
        """The recordings block of that name, or a ConfigError that lists those there are."""
        if name not in self.recordings:
            raise names.no_source(name, self.recordings)
        return self.recordings[name]


def _merge(base: Any, overrides: Any) -> Any:
    if not (isinstance(base, dict) and isinstance(overrides, dict)):
        return overrides
    return base | {key: _merge(base[key], value) if key in base else value for key, value in overrides.items()}


def load_params(path: Path, *overrides: Mapping[str, Any]) -> Params:
    """`path` with `overrides` merged in, block by block; ConfigError names every key that is wrong."""
    return read(path, Params, overrides)


def read(path: Path, model: type[_Model], overrides: Sequence[Mapping[str, Any]]) -> _Model:
    """A file of parameters with `overrides` merged in, as `model`; ConfigError names every key that is wrong."""
    values = read_yaml(path)
    for override in overrides:
        values = _merge(values, dict(override))
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise ConfigError(f"{path}: {explained(error)}") from None
