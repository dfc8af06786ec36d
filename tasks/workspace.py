"""Where every stage's files lie: under the project for `dvc repro`, under `sweeps/<id>` for everything else."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from simgap.types import ConfigError
from tasks import names

SPLITS = ("training", "test")
DIAGNOSED = "_diagnosed"
"""Ends the name of a model that is given the diagnosed simulator in place of the simulator."""
_VALUE = rf"{names.PATTERN}=[0-9.e+x-]+"
_VARIANT = re.compile(rf"({_VALUE}(,{_VALUE})*)?")
"""Names with their numbers, such as `learning_rate=0.01,hidden_layer_sizes=16x16`."""


class Cell(NamedTuple):
    """One cell of the grid: a model with a noise, trained on N transitions drawn with a seed."""

    noise: str
    model: str
    sample_size: int
    seed: int

    @property
    def name(self) -> str:
        """Readable and unique, like `sim_fsvgd-gaussian-N1000-s1`."""
        return f"{self.model}-{self.noise}-N{self.sample_size}-s{self.seed}"

    @property
    def method(self) -> str:
        """How it learns: `sim_fsvgd` of both `sim_fsvgd` and `sim_fsvgd_diagnosed`."""
        return self.model.removesuffix(DIAGNOSED)

    @property
    def share(self) -> "Share | None":
        """The recordings that its simulator is diagnosed with, if it is."""
        return Share(self.sample_size, self.seed) if self.model.endswith(DIAGNOSED) else None


class Share(NamedTuple):
    """N transitions of the training sessions in an order drawn with a seed: what a cell's diagnosis may see."""

    sample_size: int
    seed: int

    @property
    def name(self) -> str:
        """Readable and unique, like `diagnosis-N1000-s1`."""
        return f"diagnosis-N{self.sample_size}-s{self.seed}"


class TwinShare(NamedTuple):
    """The sessions that a twin is fitted to: all of them, or all but those of a fold."""

    held_out: int | None

    @property
    def name(self) -> str:
        """Readable and unique, like `all` and `without-0`."""
        return "all" if self.held_out is None else f"without-{self.held_out}"


@dataclass(frozen=True)
class Workspace:
    """The folders of one source's recordings, models and results.

    Variants, in a sweep over hyperparameters, share the recordings; each has a folder for the rest. Raises ConfigError
    where the source or the variant is no name: its folders would lie elsewhere.
    """

    root: Path
    source: str
    variant: str = ""

    def __post_init__(self) -> None:
        names.check(self.source, "the source of the recordings")
        if not _VARIANT.fullmatch(self.variant):
            raise ConfigError(f"the variant is {self.variant!r}; it must be like learning_rate=0.01,batch_size=64.")

    @property
    def lock(self) -> Path:
        """Held by the process that works on this source here."""
        return self.root / "data" / f".{self.source}.lock"

    @property
    def suffix(self) -> str:
        """Ends the names of a variant's tasks and runs."""
        return f"-{self.variant}" if self.variant else ""

    @property
    def results(self) -> Path:
        """The folder of all that is made from the recordings."""
        return self.root / self.variant

    @property
    def recordings(self) -> Path:
        return self.root / "data" / self.source / "recordings"

    @property
    def transitions(self) -> Path:
        return self.root / "data" / self.source / "transitions"

    @property
    def models(self) -> Path:
        return self.results / "models" / self.source

    @property
    def policies(self) -> Path:
        return self.results / "policies" / self.source

    @property
    def tracks(self) -> Path:
        return self.results / "tracks" / self.source

    @property
    def twins(self) -> Path:
        return self.results / "twins" / self.source

    @property
    def twin(self) -> Path:
        """The robot that stands in for the recorded one."""
        return self.twins / "twin.npz"

    @property
    def twin_record(self) -> Path:
        """What is known of it: fingerprint, effects, seconds."""
        return self.twins / "twin.json"

    @property
    def scores(self) -> Path:
        return self.results / "scores" / self.source

    @property
    def reports(self) -> Path:
        return self.results / "reports" / self.source

    @property
    def tracking(self) -> Path:
        return self.reports / "tracking"

    @property
    def twin_report(self) -> Path:
        return self.reports / "twin"

    @property
    def diagnosis(self) -> Path:
        return self.reports / "diagnosis"

    def model(self, cell: Cell) -> Path:
        return self.models / f"{cell.name}.npz"

    def record(self, cell: Cell) -> Path:
        """What is known of a finished cell: fingerprint, curve, seconds."""
        return self.models / f"{cell.name}.json"

    def augmented(self, share: Share | TwinShare) -> Path:
        """The effects' constants that a diagnosis of a share found."""
        return self._diagnosed(share, "npz")

    def effects(self, share: Share | TwinShare) -> Path:
        """What is known of that diagnosis: fingerprint, effects, seconds."""
        return self._diagnosed(share, "json")

    def _diagnosed(self, share: Share | TwinShare, suffix: str) -> Path:
        if isinstance(share, TwinShare):
            return self.twins / f"diagnosis-{share.name}.{suffix}"
        return self.models / f"{share.name}.{suffix}"

    def twin_fold(self, share: TwinShare) -> Path:
        """Scores of a twin that was not given a fold of the sessions, on these."""
        return self.twins / f"scores-{share.name}.json"

    def policy(self, cell: Cell) -> Path:
        """The policy learnt in the cell's model."""
        return self.policies / f"{cell.name}.npz"

    def policy_record(self, cell: Cell) -> Path:
        """What is known of a finished policy: fingerprint, curve, seconds."""
        return self.policies / f"{cell.name}.json"

    def checkpoint(self, cell: Cell) -> Path:
        """Where learning a policy goes on from when it was interrupted."""
        return self.policies / f"{cell.name}.checkpoint.npz"

    def runs(self, name: str) -> Path:
        """What was done along every reference, of a policy or a controller."""
        return self.tracks / f"{name}.npz"
