"""The result of a diagnosis, for Python and for notebooks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np

from simgap.diagnosis.diagnose import Diagnosis
from simgap.effects.regime import Acting
from simgap.engines import Engine
from simgap.formats import diagnoses
from simgap.formats.documents import write_bytes, write_text
from simgap.formats.folders import make_folder
from simgap.loading.load import Used
from simgap.page import diagnosis as pages
from simgap.simulators.augmented import AugmentedSimulator
from simgap.types import ConfigError, Sessions, StepModel


@dataclass(frozen=True)
class Effect:
    """One missing effect.

    id: in the catalogue. statement: the effect in words. probability: of its name. outputs: where it shows. channels:
    commands that it acts on. constants: by name, each with value, unit and 95 % interval.
    """

    id: str
    statement: str
    probability: float
    outputs: tuple[str, ...]
    channels: tuple[str, ...]
    constants: dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Picture:
    """A picture as SVG, which a notebook shows."""

    svg: bytes

    def save(self, path: str | PathLike[str]) -> None:
        """Write it to a file, such as `forecasts.svg`."""
        write_bytes(Path(path), self.svg)

    def _repr_svg_(self) -> str:
        return self.svg.decode()


@dataclass(frozen=True)
class Result:
    """What a simulator leaves out, according to recordings.

    diagnosed: the simulator. found: the diagnosis, with the arrays behind its pictures. left_out: why sessions of a
    folder were not used.
    """

    diagnosed: StepModel | Engine
    found: Diagnosis
    left_out: tuple[str, ...] = ()

    @staticmethod
    def of(used: Used, sessions: Sessions, found: Diagnosis, left_out: Sequence[str]) -> "Result":
        """The result for a simulator; for a model file also in the model's own terms."""
        if used.model_file is None:
            return Result(used.simulator, found, tuple(left_out))
        from simgap.simulators.mujoco import account

        result, file = Result(used.simulator, found, tuple(left_out)), f"{Path(used.name).stem}{diagnoses.PATCHED}"
        statement = found.statement | {"model_file": used.model_file}
        statement = account.account(result._engine, found.model, statement, file, sessions.fitted)
        statement["notes"] = [*used.left_out, *statement["notes"]]
        return replace(result, found=found._replace(statement=statement))

    @property
    def statement(self) -> dict[str, Any]:
        """The whole diagnosis, as in `diagnosis.json` (docs/reference/diagnosis_json.md)."""
        return self.found.statement

    @property
    def verdict(self) -> str:
        """`missing_physics`, `parameters_only`, `nothing`, `unexplained` or `inconclusive`."""
        return self.statement["verdict"]

    @property
    def effects(self) -> list[Effect]:
        """The effects that are missing, in the order of the statement."""
        return [
            Effect(
                e["id"], e["statement"], e["probability"], tuple(e["outputs"]), tuple(e["channels"]),
                {c["name"]: {key: c[key] for key in ("value", "unit", "ci95")} for c in e["constants"]},
            )
            for e in self.statement["effects"]
        ]  # fmt: skip

    @cached_property
    def simulator(self) -> AugmentedSimulator:
        """The simulator with these effects; its nominal parameters (`simgap.nominal`) are the fitted ones."""
        model = self.found.model
        acting = Acting(model.theta, model.delta, model.regimes)
        return diagnoses.corrected(self._engine, model.phi, acting, model.scales)

    @cached_property
    def _engine(self) -> Any:
        """The simulator that was diagnosed, with the hidden state that was named, if one was."""
        return diagnoses.with_hidden(self.diagnosed, self.found.model.behind)

    @property
    def experiment(self) -> dict[str, np.ndarray] | None:
        """Commands that would separate the likeliest explanations, by column, `time_s` first; None without any."""
        if self.found.experiment is None:
            return None
        time_s, commands = self.found.experiment
        names = [f.name for f in self.diagnosed.schema.command]
        return {"time_s": time_s, **dict(zip(names, commands.T, strict=True))}

    def to_html(self, path: str | PathLike[str] | None = None) -> str:
        """The page as one self-contained document; also written to `path` if one is given."""
        page = pages.page(self.statement, self.found.evidence)
        if path is not None:
            write_text(Path(path), page)
        return page

    def save(self, folder: str | PathLike[str]) -> None:
        """Write the diagnosis to a folder.

        The files are `diagnosis.json`, `diagnosis.html`, `augmented.npz` (from which `simgap.load` makes the
        simulator), `experiment.csv` if an experiment is proposed, and the corrected model if a model file was
        diagnosed.
        """
        make_folder(Path(folder))
        diagnoses.write(Path(folder), self.found, self.to_html(), self.diagnosed.schema, self._models(Path(folder)))

    def _models(self, folder: Path) -> dict[str, str]:
        """Corrected model files for a folder, by name."""
        if not self.statement.get("patched"):
            return {}
        from simgap.simulators.mujoco import account

        patched = account.patched(self._engine, self.found.model, self.statement, folder)
        return {self.statement["patched"]["file"]: patched.xml}

    def plot(self, what: Literal["forecasts", "laws", "sessions", "experiment"] = "forecasts") -> list[Picture]:
        """Pictures of the page.

        They are forecasts of held-out sessions with the measurements, the effects' laws over the data, the excess error
        of every session over time, or the commands of the proposed experiment.
        """
        figures = pages.figures(self.statement, self.found.evidence)
        drawn = {
            "forecasts": figures.rollouts,
            "laws": figures.laws,
            "sessions": [figures.strips] if figures.strips else [],
            "experiment": [figures.commands] if figures.commands else [],
        }
        if what not in drawn:
            raise ConfigError(f"plot must be one of {', '.join(drawn)}; it is {what!r}.")
        return [Picture(figure["svg"]) for figure in drawn[what]]

    def __str__(self) -> str:
        return self.statement["statement"]

    def _repr_html_(self) -> str:
        # In a frame, so that the page's style does not apply to the notebook.
        return f'<iframe srcdoc="{escape(self.to_html())}" width="100%" height="700" style="border:0"></iframe>'
