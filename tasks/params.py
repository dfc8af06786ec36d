"""params.yaml, read once into typed, frozen configurations; an unknown, missing or impossible key is named."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from simgap import fsvgd, identify, priors
from simgap.policies import environment, follow, learn, references, sac
from simgap.types import ConfigError

YAML_LIMIT, YAML_DEPTH = 2**20, 20
"""Greatest size [bytes] and nesting of a YAML file."""

ModelName = Literal["sim_model", "fsvgd", "sim_fsvgd", "sim_model_diagnosed", "sim_fsvgd_diagnosed"]
NoiseName = Literal["gaussian", "student_t"]
Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Many = Annotated[int, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
_Model = TypeVar("_Model", bound=BaseModel)


def _known_keys(config: type) -> Callable[[Any], Any]:
    """A dataclass of `simgap` ignores unknown keys when validated; here they are refused, in those within it too."""
    names = {f.name for f in dataclasses.fields(config)}
    within = {f.name: _known_keys(f.type) for f in dataclasses.fields(config)
              if isinstance(f.type, type) and dataclasses.is_dataclass(f.type)}  # fmt: skip

    def check(value: Any) -> Any:
        if isinstance(value, Mapping):
            if set(value) - names:
                raise ValueError(
                    f"unknown key {', '.join(sorted(set(value) - names))}; known are {', '.join(sorted(names))}"
                )
            for name in within.keys() & value.keys():
                within[name](value[name])
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


class PolicyParams(_Block):
    noise: NoiseName = Field(description="Family of the likelihood of the models that policies learn in.")
    models: list[ModelName] = Field(min_length=1)
    sample_sizes: list[Annotated[int, Field(ge=20)]] = Field(min_length=1, description="N, of the models.")
    seeds: list[Annotated[int, Field(ge=0)]] = Field(min_length=1)
    workers: Count = Field(description="Policies learnt side by side.")
    environment: Annotated[environment.Config, BeforeValidator(_known_keys(environment.Config))]
    learning: Annotated[learn.Config, BeforeValidator(_known_keys(learn.Config))]
    sac: Annotated[sac.Config, BeforeValidator(_known_keys(sac.Config))]


class ProportionalParams(_Block):
    """What policies are compared with, a controller for every gain."""

    gains: list[Positive] = Field(description="Of the hand [1/s].")
    base_gain: Positive = Field(description="Of the base [1/s].")
    rest: tuple[float, float, float] = Field(description="Where the base would have the hand, in its frame [m].")


class TrackParams(_Block):
    seed: int = Field(ge=0, description="Seed of the robot's noise.")
    robot_limit: tuple[Positive, Positive, Positive, Positive, Positive, Positive] = Field(
        description="Greatest commands that the robot admits."
    )
    ellipse: Annotated[references.Ellipse, BeforeValidator(_known_keys(references.Ellipse))]
    helix: Annotated[references.Helix, BeforeValidator(_known_keys(references.Helix))]
    bounds: Annotated[follow.Bounds, BeforeValidator(_known_keys(follow.Bounds))]
    proportional: ProportionalParams


class DiagnoseParams(_Block):
    seed: int = Field(ge=0, description="Seed of what is drawn: resampled sessions, simulated data, the black box.")


class Params(_Block):
    """The whole of params.yaml."""

    recordings: dict[str, VirtualParams | FolderParams] = Field(min_length=1)
    transitions: TransitionsParams
    train: TrainParams
    score: ScoreParams
    report: ReportParams
    policy: PolicyParams
    track: TrackParams
    diagnose: DiagnoseParams

    def source(self, name: str) -> VirtualParams | FolderParams:
        """The recordings block of that name, or a ConfigError that lists those there are."""
        if name not in self.recordings:
            raise ConfigError(
                f"params.yaml has no block recordings.{name}; there are {', '.join(self.recordings)}. "
                "Add one, with the keys folder, training and test."
            )
        return self.recordings[name]


class ConcealParams(_Block):
    """What a suite holds; counts of cases, strengths in nats."""

    seed: Many = Field(description="Seed of the development suite; an examination's comes from the diagnosing code.")
    round: Many = Field(description="Which examination of the same code.")
    nulls: Many
    effects: list[str] = Field(description="Ids of single effects; empty: all there are.")
    strengths: list[Positive] = Field(description="A case of every effect at each.")
    duel_strengths: list[Positive]
    pairs: Many
    triples: Many
    regimes: Many = Field(description="Effects that act in a regime only.")
    onsets: Many = Field(description="Effects that act from a time on only.")
    outside_strengths: list[Positive] = Field(description="A case of every law outside the vocabulary at each.")
    parts: Count = Field(description="Stratified samples that the suite is dealt out into.")
    few: Share = Field(description="Of all cases: few data.")
    poor: Share = Field(description="Of all cases: poor excitation.")
    glitches: Share = Field(description="Of all cases: glitches in what is measured.")
    real: FolderParams = Field(description="Recordings of a real Spot, for the suite of that name.")


class ExamineParams(_Block):
    parts: list[Many] = Field(description="Parts of the suite to be diagnosed; empty: all.")
    workers: Count = Field(description="Processes that diagnose.")
    seed: Many = Field(description="Seed of what the diagnosis draws.")
    patience_s: Positive = Field(description="Time after which a diagnosis is given up [s].")


class SealedScoreParams(_Block):
    seed: Many = Field(description="Seed of bootstrap intervals.")
    figure_dpi: Count
    pictures: Many = Field(description="Failures that are drawn.")


class SealedParams(_Block):
    """The whole of sealed/params.yaml."""

    conceal: ConcealParams
    examine: ExamineParams
    score: SealedScoreParams


def _merge(base: Any, overrides: Any) -> Any:
    if not (isinstance(base, dict) and isinstance(overrides, dict)):
        return overrides
    return {key: _merge(base[key], overrides[key]) if key in base and key in overrides else {**base, **overrides}[key]
            for key in {**base, **overrides}}  # fmt: skip


def read_yaml(path: Path) -> Any:
    """What a YAML file holds; ConfigError when it is missing, damaged or made to harm."""
    try:
        if path.stat().st_size > YAML_LIMIT:
            raise ValueError(f"it has more than {YAML_LIMIT:,} bytes")
        text = path.read_text(encoding="utf-8")
        _refuse_bombs(text)
        return yaml.safe_load(text)
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: cannot be read ({' '.join(str(error).split())}).") from None


def _refuse_bombs(text: str) -> None:
    """ValueError where a text nests deeper than any configuration, or repeats parts of itself: both can fill memory."""
    depth = 0
    for event in yaml.parse(text, yaml.SafeLoader):
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent):
            raise ValueError(f"line {line} has the alias *{event.anchor}; write out what it stands for")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > YAML_DEPTH:
            raise ValueError(f"line {line} is nested more than {YAML_DEPTH} deep")


def load_params(path: Path, *overrides: Mapping[str, Any]) -> Params:
    """`path` with `overrides` merged in, block by block; ConfigError names every key that is wrong."""
    return _load(path, Params, overrides)


def load_sealed(path: Path, *overrides: Mapping[str, Any]) -> SealedParams:
    """The same of the sealed suites' file."""
    return _load(path, SealedParams, overrides)


def _load(path: Path, model: type[_Model], overrides: Sequence[Mapping[str, Any]]) -> _Model:
    values = read_yaml(path)
    for override in overrides:
        values = _merge(values, dict(override))
    try:
        return model.model_validate(values)
    except ValidationError as error:
        lines = [f"  {'.'.join(str(part) for part in e['loc'])}: {e['msg']}" for e in error.errors()]
        raise ConfigError(f"{path}: {len(lines)} values are wrong:\n" + "\n".join(lines)) from None
