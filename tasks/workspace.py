"""Where every stage's files lie: under the project for `dvc repro`, under `sweeps/<id>` for everything else."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

SPLITS = ("training", "test")


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


@dataclass(frozen=True)
class Workspace:
    """The folders of one source's recordings, models and results."""

    root: Path
    source: str

    @property
    def recordings(self) -> Path:
        return self.root / "data" / self.source / "recordings"

    @property
    def transitions(self) -> Path:
        return self.root / "data" / self.source / "transitions"

    @property
    def models(self) -> Path:
        return self.root / "models" / self.source

    @property
    def scores(self) -> Path:
        return self.root / "scores" / self.source

    @property
    def reports(self) -> Path:
        return self.root / "reports" / self.source

    @property
    def diagnosis(self) -> Path:
        return self.reports / "diagnosis"

    def model(self, cell: Cell) -> Path:
        return self.models / f"{cell.name}.npz"

    def record(self, cell: Cell) -> Path:
        """What is known of a finished cell: fingerprint, curve, seconds."""
        return self.models / f"{cell.name}.json"
