"""What every name and number of params.yaml may be, declared once: for the file, for forms and for the command line.

The bounds keep out what cannot be meant; inside them a value may still be a poor choice.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Annotated, Any, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    create_model,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from simgap.formats.validation import NUMBER
from simgap.loading import seeds
from simgap.types import ConfigError
from tasks import names

MOST_SESSIONS, LONGEST_SESSION_S = 1000, 3600
MOST_VALUES = 1000
"""Entries at most of a list of seeds, sizes, strengths or values to try."""
MOST_CELLS = 10_000
"""Cells at most of a grid. Each is trained and has a run in MLflow: at a minute a cell, this is a week."""

Name = Annotated[
    str,
    AfterValidator(names.check),
    Field(json_schema_extra={"pattern": f"^{names.PATTERN}$", "maxLength": names.LONGEST}),
]
"""What becomes a file or a folder."""
Seed = Annotated[int, Field(ge=0, le=seeds.LARGEST), NUMBER]
SampleSize = Annotated[int, Field(ge=20, le=1_000_000), NUMBER]
Sessions = Annotated[int, Field(ge=1, le=MOST_SESSIONS), NUMBER]
SessionsOr0 = Annotated[int, Field(ge=0, le=MOST_SESSIONS), NUMBER]
SessionLength = Annotated[float, Field(gt=0, le=LONGEST_SESSION_S), NUMBER]
SessionLengthOr0 = Annotated[float, Field(ge=0, le=LONGEST_SESSION_S), NUMBER]
Workers = Annotated[int, Field(ge=1, le=1024), NUMBER]
Steps = Annotated[int, Field(ge=1, le=100_000), NUMBER]
Rate = Annotated[float, Field(gt=0, le=10_000), NUMBER]
"""Rows per second."""
Dpi = Annotated[int, Field(ge=1, le=1200), NUMBER]
Gain = Annotated[float, Field(gt=0, le=1000), NUMBER]
Speed = Annotated[float, Field(gt=0, le=100), NUMBER]
Metres = Annotated[float, Field(ge=-100, le=100), NUMBER]
Strength = Annotated[float, Field(gt=0, le=1_000_000), NUMBER]
"""Of a concealed effect [nat]."""
Cases = Annotated[int, Field(ge=0, le=100_000), NUMBER]
Parts = Annotated[int, Field(ge=1, le=1000), NUMBER]
Part = Annotated[int, Field(ge=0, lt=1000), NUMBER]
SessionFiles = Annotated[int, Field(ge=2, le=26), NUMBER]
"""A letter each."""
SessionRows = Annotated[int, Field(ge=50, le=100_000), NUMBER]
Patience = Annotated[float, Field(gt=0, le=604_800), NUMBER]
"""At most a week [s]."""
Share = Annotated[float, Field(ge=0, le=1), NUMBER]

_COUNT = {"ge": 1, "le": 10_000_000}
_RATE = {"gt": 0, "le": 1}
_BETWEEN = {"gt": 0, "lt": 1}
_LENGTH = {"gt": 0, "le": 1000}
_WEIGHT = {"ge": 0, "le": 1_000_000}
_WIDTHS = {"ge": 1, "le": 4096}
_PLACE = {"ge": -100, "le": 100}
RANGES: Mapping[str, Mapping[str, Any]] = {
    # fsvgd.Config and identify.Config
    "particles": {"ge": 1, "le": 100, "description": "L, networks of an ensemble."},
    "batch_size": {"ge": 1, "le": 4096},
    "epochs": {"ge": 1, "le": 10_000, "description": "Of N steps each."},
    "max_training_steps": _COUNT,
    "training_steps": _COUNT,
    "learning_rate": _RATE,
    "weight_decay": {"ge": 0, "le": 1},
    "hidden_layer_sizes": {**_WIDTHS, "description": "Units of every layer, such as [64, 64]."},
    "likelihood_exponent": {"gt": 0, "le": 10},
    "bandwidth_svgd": {"gt": 0, "le": 1000},
    "validation_share": {**_BETWEEN, "description": "Of the N, for early stopping."},
    "measurement_sets": {"ge": 1, "le": 100_000},
    "evaluate_every": {**_COUNT, "description": "Steps between validations."},
    "patience": {**_COUNT, "description": "Steps without a better validation after which training ends."},
    # priors.Config and SimulatorConfig
    "lengthscale": {"gt": 0, "le": 1000, "description": "Of the Gaussian process, on normalised inputs."},
    "outputscale": {"gt": 0, "le": 1000, "description": "Of the Gaussian process, on normalised outputs."},
    "measurement_points": {"ge": 1, "le": 4096, "description": "Points of a set, in addition to the batch."},
    "function_samples": {"ge": 2, "le": 100_000, "description": "Simulators drawn for the prior's moments."},
    # residual.config.Config
    "simulator_steps": {**_COUNT, "description": "Of the simulator's fit."},
    "simulator_learning_rate": _RATE,
    "simulator_batch": {"ge": 1, "le": 1_000_000},
    "durations": {"ge": 1, "le": 100, "description": "Q, equally likely ones of a row."},
    "outputscales": {"gt": 0, "le": 1000, "description": "Of the residual, to choose from."},
    "lengthscales": {"gt": 0, "le": 1000, "description": "Of the residual, to choose from."},
    "heldout_share": {**_BETWEEN, "description": "Of the N, in whole sessions, to choose by."},
    "paces": {"gt": 0, "le": 100, "description": "Steps a row of a long prediction lasts, to choose from."},
    "horizon": {"ge": 1, "le": 100_000, "description": "Rows of a long prediction."},
    # twin.config.Config
    "stride": {"ge": 1, "le": 100_000, "description": "Rows between starts of windows."},
    "folds": {"ge": 2, "le": 1000, "description": "Of the sessions, each held out once."},
    "replays": {"ge": 1, "le": 10_000, "description": "Runs with recorded departures, from every start."},
    # environment.Config and its reward
    "command_limit": {"gt": 0, "le": 100},
    "start_motion": {"ge": 0, "le": 1},
    "goal_distance": _LENGTH,
    "goal_height": {"ge": 0, "le": 100},
    "noise": {"ge": 0, "le": 100},
    "escape": {"ge": 1, "le": 1_000_000},
    "state_bound": {"ge": 0, "le": 1000},
    "state_margin": _LENGTH,
    "state_value": _BETWEEN,
    "arm_length": {"ge": 0, "le": 1000},
    "arm_margin": _LENGTH,
    "arm_value": _BETWEEN,
    "base_cost": _WEIGHT,
    "ee_cost": _WEIGHT,
    "state_weight": _WEIGHT,
    "arm_weight": _WEIGHT,
    "action_weight": _WEIGHT,
    # learn.Config
    "environment_steps": {"ge": 1, "le": 1_000_000_000},
    "episode_length": {"ge": 1, "le": 100_000},
    "steps_between_updates": {"ge": 1, "le": 100_000},
    "environments": {"ge": 1, "le": 100_000},
    "updates": {"ge": 1, "le": 1_000_000},
    "min_replay": {"ge": 1, "le": 100_000_000},
    "max_replay": {"ge": 1, "le": 100_000_000},
    "evaluations": {"ge": 1, "le": 10_000},
    "evaluation_environments": {"ge": 1, "le": 100_000},
    "plateau": {"ge": 0, "le": 10_000},
    "plateau_gain": {"ge": 0, "le": 1},
    # sac.Config
    "learning_rate_alpha": _RATE,
    "learning_rate_policy": _RATE,
    "learning_rate_q": _RATE,
    "max_gradient_norm": {"gt": 0, "le": 1_000_000_000},
    "discounting": _RATE,
    "tau": _RATE,
    "target_entropy": {"ge": -100, "le": 100},
    "policy_hidden_layers": _WIDTHS,
    "critic_hidden_layers": _WIDTHS,
    # references.Ellipse and Helix
    "semi_axes": {**_PLACE, "description": "Along x, y and z [m]."},
    "period": {"gt": 0, "le": 600, "description": "Of a round or a turn [s]."},
    "rounds": {"gt": 0, "le": 100, "description": "Of the ellipse."},
    "radius": {"gt": 0, "le": 100, "description": "In y and z [m]."},
    "advance": {**_PLACE, "description": "Along x a turn [m]."},
    "turns": {"gt": 0, "le": 100, "description": "Of the helix."},
    # bounds.Bounds
    "shoulder": _PLACE,
    "reach": {"gt": 0, "le": 100},
    "clearance": {"ge": 0, "le": 100},
    "body_low": _PLACE,
    "body_high": _PLACE,
    "look_ahead": {"ge": 0, "le": 60},
}
"""By the name of a configuration's key; of a list, the range of its entries."""
MOST_ENTRIES = 100
"""Of a list of any length, such as the widths of a network's layers."""


def check_cells(*counts: int) -> None:
    """ConfigError where a grid has more than `MOST_CELLS` cells; counts: the values along each of its axes."""
    if (cells := math.prod(counts)) > MOST_CELLS:
        raise ConfigError(f"the grid has {cells:,} cells; it may have {MOST_CELLS:,}. Give fewer values to try.")


class Strict(BaseModel):
    """A block of a file: no unknown key, no number that is not finite, unchangeable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _known(cls, values: Any) -> Any:
        """ConfigError that names unknown keys, and those there are."""
        unknown = set(values) - set(cls.model_fields) if isinstance(values, Mapping) else ()
        if unknown:
            raise ConfigError(f"unknown key {', '.join(map(str, unknown))}; known are {', '.join(cls.model_fields)}")
        return values


def bounded(key: dataclasses.Field[Any]) -> Any:
    """The type of a configuration's key with its range; KeyError where `RANGES` lacks a number's key."""
    if key.type is bool:
        return Annotated[bool, Field(strict=True)]
    limits = {name: value for name, value in RANGES[key.name].items() if name != "description"}
    if get_origin(key.type) is not tuple:
        return Annotated[key.type, Field(**limits), NUMBER]
    entries = tuple(e if e is Ellipsis else Annotated[e, Field(**limits), NUMBER] for e in get_args(key.type))
    listed = tuple[entries]  # type: ignore[valid-type]
    return Annotated[listed, Field(max_length=MOST_ENTRIES)] if Ellipsis in entries else listed


class Ranged:
    """Annotates a configuration of `simgap` in a block: its keys are checked by `RANGES` before it is made."""

    def __get_pydantic_core_schema__(self, config: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        keys: dict[str, Any] = {
            key.name: (Annotated[key.type, Ranged()] if dataclasses.is_dataclass(key.type) else bounded(key), ...)  # type: ignore[name-defined]
            for key in dataclasses.fields(config)
        }
        block = create_model(config.__qualname__, __base__=Strict, **keys)
        return core_schema.no_info_after_validator_function(
            lambda checked: config(**{name: getattr(checked, name) for name in keys}),
            handler.generate_schema(block),
            serialization=core_schema.plain_serializer_function_ser_schema(dataclasses.asdict),
        )
