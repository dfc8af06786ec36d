"""Parameters of the stages that diagnose machines other than the Spot: public recordings, and the training ground."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from tasks.params import read
from tasks.ranges import Cases, Name, Seed, Strict, Workers


class ExternalCase(Strict):
    """A machine that nobody here made, and what its makers say is left out of a simple simulator of it."""

    name: Name = Field(description="Name of the machine in the table of runs.")
    simulator: str = Field(description="`module:name`, or the path of an MJCF or URDF in the folder.")
    recordings: list[str] = Field(min_length=1, description="Glob patterns of sessions in the folder.")
    heldout: list[str] = Field(default=[], description="Of sessions to judge by; none: every fourth of the others.")
    causes: list[list[str]] = Field(description="What is left out: of every cause, the effects that name it rightly.")


class ExternalParams(Strict):
    """The whole of pipelines/external/params.yaml."""

    seed: Seed = Field(description="Seed of what a diagnosis draws.")
    folder: Path = Field(description="Folder of the machines' recordings, absolute or from the project's root.")
    cases: list[ExternalCase] = Field(description="The machines.")


class GroundParams(Strict):
    """The whole of pipelines/ground/params.yaml."""

    seed: Seed = Field(description="Seed of what a diagnosis draws.")
    first: Cases = Field(description="Number of the first case; a case is drawn from its number.")
    cases: Cases = Field(description="How many cases.")
    workers: Workers = Field(description="Cases diagnosed at the same time, each in a process of its own.")


def load_external(path: Path, *overrides: Mapping[str, Any]) -> ExternalParams:
    """`path` with `overrides` merged in, block by block; ConfigError names every key that is wrong."""
    return read(path, ExternalParams, overrides)


def load_ground(path: Path, *overrides: Mapping[str, Any]) -> GroundParams:
    """The same of the training ground's file."""
    return read(path, GroundParams, overrides)
