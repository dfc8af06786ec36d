"""What a person may ask for, as typed forms: Prefect's pages draw them, and check what is put in.

A list of hyperparameters that is left empty takes what params.yaml has.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, create_model

from simgap import fsvgd, identify, priors
from simgap.formats.validation import NUMBER, check
from simgap.residual import config
from simgap.types import ConfigError
from tasks import names
from tasks.params import FolderParams, Models, NoiseName, Noises, Params, SampleSizes, Seeds, VirtualParams
from tasks.ranges import MOST_VALUES, RANGES, Name, SessionLengthOr0, SessionsOr0, bounded, check_cells

SWEEPS = Path("sweeps")
"""Where whatever is not `dvc repro` writes; git and DVC leave it alone."""

RunName = Annotated[
    str,
    AfterValidator(names.check_run),
    Field(
        json_schema_extra={
            "pattern": f"^{names.PATTERN}$",
            "maxLength": names.LONGEST,
            "not": {"pattern": f"^({names.ALIASES})$"},
        }
    ),
]
"""Of a run, of its folder under `sweeps/` and in MLflow; the form refuses what `names.check_run` does."""


class _Form(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Recordings(_Form):
    """The recordings to learn from."""

    source: Name = Field(description="A block of params.yaml's recordings, such as virtual or spot.")
    folder: str = Field("", description="Folder in the project, in place of the block's; empty: the block's.")
    training_sessions: SessionsOr0 = Field(0, description="Of the virtual robot; 0: as in params.yaml.")
    test_sessions: SessionsOr0 = Field(0, description="Of the virtual robot; 0: as in params.yaml.")
    session_s: SessionLengthOr0 = Field(0, title="Session length", description="Of each [s]; 0: as in params.yaml.")

    def overrides(self, params: Params) -> dict[str, Any]:
        """What it changes in params.yaml; a block has fields for the virtual robot or a folder, not both."""
        fields = type(params.source(self.source)).model_fields
        block = {name: value for name, value in self.model_dump(exclude={"source"}).items() if value and name in fields}
        if self.folder and "folder" not in fields:
            raise ConfigError(
                f"recordings.folder: the source {self.source} has no folder, its robot is virtual. Name a source with "
                "one, such as spot, or leave the folder empty."
            )
        return {"recordings": {self.source: block}} if block else {}


class Grid(_Form):
    """What a sweep trains."""

    models: Models
    noises: Noises
    sample_sizes: SampleSizes
    seeds: Seeds


class Policies(_Form):
    """The policies to learn, and the models to learn them in."""

    noise: NoiseName = Field(description="Family of the likelihood of the models.")
    models: Models = Field(description="How the models learn.")
    sample_sizes: SampleSizes = Field(description="N, transitions that the models learn from.")
    seeds: Seeds = Field(description="Of models and policies.")
    environment_steps: Annotated[int, NUMBER] = Field(
        description="Environment steps per policy, at most.", **RANGES["environment_steps"]
    )
    learning_rate: Annotated[float, NUMBER] = Field(
        description="Of soft actor-critic: actor, critics and temperature.", **RANGES["learning_rate_policy"]
    )

    def overrides(self) -> dict[str, Any]:
        """What it changes in the blocks `train` and `policy` of params.yaml."""
        grid = self.model_dump(include={"models", "sample_sizes", "seeds"})
        rates = {f"learning_rate_{part}": self.learning_rate for part in ("alpha", "policy", "q")}
        learning = {"environment_steps": self.environment_steps}
        return {
            "train": {**grid, "noises": [self.noise]},
            "policy": {**grid, "noise": self.noise, "learning": learning, "sac": rates},
        }


def policies(params: Params) -> dict[str, Any]:
    """What the form of the policies holds before anyone changes it: params.yaml's own."""
    policy = params.policy
    return {
        **{name: getattr(policy, name) for name in ("noise", "models", "sample_sizes", "seeds")},
        "environment_steps": policy.learning.environment_steps,
        "learning_rate": policy.sac.learning_rate_policy,
    }


def _values(config: type, what: str) -> Any:
    """A form with a list of values to try for every field of a configuration."""
    fields: dict[str, Any] = {
        f.name: (
            list[bounded(f)],
            Field(default_factory=list, max_length=MOST_VALUES, description=RANGES[f.name].get("description")),
        )
        for f in dataclasses.fields(config)
    }
    return create_model(what, __base__=_Form, __doc__=f"Values to try of train.{what}; a list left empty takes "
                        "params.yaml's.", **fields)  # fmt: skip


_BLOCKS = {
    "bnn": fsvgd.Config,
    "fsvgd": priors.Config,
    "sim_fsvgd": priors.SimulatorConfig,
    "sim_model": identify.Config,
    "residual": config.Config,
}
Hyperparameters = create_model(
    "Hyperparameters", __base__=_Form, __doc__="Values to try, block by block; every combination is trained.",
    **{name: (form := _values(config, name), Field(default_factory=form)) for name, config in _BLOCKS.items()},  # type: ignore[call-overload]
)  # fmt: skip
"""The blocks of `train` in params.yaml with lists for values."""


def defaults(params: Params, source: str) -> dict[str, Any]:
    """What a sweep's form holds before anyone changes it: params.yaml's own experiment."""
    train, block = params.train, params.source(source)
    sessions = block.model_dump(exclude={"seed"}) if isinstance(block, VirtualParams) else {}
    return {
        "recordings": {"source": source, **sessions},
        "models": train.models,
        "noises": train.noises,
        "sample_sizes": train.sample_sizes,
        "seeds": train.seeds,
        "hyperparameters": {
            block: {f.name: [_plain(getattr(getattr(train, block), f.name))] for f in dataclasses.fields(config)}
            for block, config in _BLOCKS.items()
        },
    }


def with_sources(schema: dict[str, Any], sources: Sequence[str]) -> None:
    """Let the schema of a flow's form, its definitions, offer these sources as a choice."""
    schema["Recordings"]["properties"]["source"]["enum"] = list(sources)


def besides(overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Of overrides of params.yaml, those that the forms have no fields for."""
    own = ("models", "noises", "noise", "sample_sizes", "seeds")
    return {
        block: {name: value for name, value in values.items() if name not in own}
        for block, values in overrides.items()
        if block != "recordings"
    }


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def variants(hyperparameters: BaseModel) -> list[dict[str, Any]]:
    """Every combination of the values, as overrides of `train` by dotted name; ConfigError where they are too many."""
    given = {
        f"{block}.{name}": values
        for block, form in hyperparameters.model_dump().items()
        for name, values in form.items()
        if values
    }
    check_cells(*map(len, given.values()))
    return [dict(zip(given, chosen, strict=True)) for chosen in product(*given.values())]


def label(chosen: Mapping[str, Any], hyperparameters: BaseModel, method: str) -> str:
    """What sets a variant's cell apart, such as `learning_rate=0.01`: of the values tried, those that it depends on."""
    tried = {f"{block}.{name}" for block, form in hyperparameters.model_dump().items()
             for name, values in form.items() if len(values) > 1}  # fmt: skip
    blocks = ("sim_model",) if method == "sim_model" else ("bnn", method)
    return ",".join(f"{name.split('.')[1]}={_short(value)}" for name, value in chosen.items()
                    if name in tried and name.split(".")[0] in blocks)  # fmt: skip


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "x".join(map(str, value))
    return f"{value:g}" if float(f"{value:g}") == value else repr(value)  # two values never share a label


def nested(flat: Mapping[str, Any]) -> dict[str, Any]:
    """`{"bnn.particles": 5}` as `{"bnn": {"particles": 5}}`."""
    tree: dict[str, Any] = {}
    for name, value in flat.items():
        block, key = name.split(".")
        tree.setdefault(block, {})[key] = value
    return tree


def read_values(texts: Sequence[str]) -> BaseModel:
    """`bnn.learning_rate=0.001,0.01` and the like, as on a command line; ConfigError names what is wrong."""
    found: dict[str, dict[str, Any]] = {}
    for text in texts:
        name, equals, values = text.partition("=")
        block, dot, key = name.partition(".")
        if not (equals and dot):
            raise ConfigError(f"{text!r}: give a hyperparameter as block.name=value,value, like "
                              "bnn.learning_rate=0.001,0.01.")  # fmt: skip
        found.setdefault(block, {})[key] = values
    return check(Hyperparameters, {
        block: {key: _listed(key, values) for key, values in keys.items()} for block, keys in found.items()
    })  # fmt: skip


def _listed(key: str, values: str) -> list[Any]:
    several = key in ("hidden_layer_sizes", "outputscales", "lengthscales", "paces")  # 64x64,128x128
    return [value.split("x") if several else value for value in values.split(",")]


def folder(name: str) -> Path:
    """The folder of a run under `sweeps/`; ConfigError where the name would lead out of it, or hide."""
    return SWEEPS / names.check_run(name)


def inside(path: Path | str) -> Path:
    """A path below the project, as it is written; ConfigError for any other. A link in the project may lead out."""
    pure = PurePosixPath(path)
    if pure.is_absolute() or ".." in pure.parts or "\0" in str(path) or not pure.parts:
        raise ConfigError(
            f"{str(path)!r}: a folder given in a form must lie in the project: a relative path without `..`, like "
            "data/external/mine. Put the recordings there, or link to them from there."
        )
    return Path(path)


def check_source(params: Params, source: str) -> None:
    """The source is there, and its recordings lie in the project; ConfigError otherwise."""
    block: VirtualParams | FolderParams = params.source(source)
    if isinstance(block, FolderParams):
        inside(block.folder)
