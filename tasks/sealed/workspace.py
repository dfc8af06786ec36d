"""Where a sealed suite's files lie: recordings, keys apart from them, what was said, and the report."""

from dataclasses import dataclass
from pathlib import Path

from tasks import names

EXAMINATION = "examination"
ARM = "arm"
KINDS = "kinds"
TIES = "ties"
SUITES = ("development", EXAMINATION, "engine", "real", ARM, TIES, KINDS)
BEFORE, AFTER = "before", "after"
"""Folders of a case whose question is what changed."""
RECORDED, PRESCRIBED = "recorded", "prescribed"
"""Folders of a case with the sessions of an experiment that a diagnosis prescribed."""
MODEL = "robot.xml"
"""The model of the machine, in the folder of a case that has one."""
SIMULATOR = "simulator.txt"
"""The name of the machine's simulator, in the folder of a case that has one; without either it is the Spot."""


@dataclass(frozen=True)
class SealedWorkspace:
    """The folders of one suite under `root`; ConfigError where the suite, or later a case, is no name."""

    root: Path
    suite: str

    def __post_init__(self) -> None:
        names.check(self.suite, "the suite")

    @property
    def has_models(self) -> bool:
        """Whether its cases are machines with a model file of their own."""
        return self.suite == ARM

    @property
    def has_spots(self) -> bool:
        """Whether its cases are the Spot."""
        return self.suite not in (ARM, KINDS)

    @property
    def lock(self) -> Path:
        """Held by the process that works on this suite here."""
        return self.root / "data" / "sealed" / f".{self.suite}.lock"

    @property
    def data(self) -> Path:
        return self.root / "data" / "sealed" / self.suite

    @property
    def cases(self) -> Path:
        """A recording set a case."""
        return self.data / "cases"

    def case(self, case: str) -> Path:
        """All recordings of a case."""
        return self.cases / names.check(case, "a case")

    def recordings(self, case: str) -> Path:
        """A case's sessions; those after, where there are some from before a change, and without those prescribed."""
        folders = (self.case(case) / name for name in (AFTER, RECORDED))
        return next((folder for folder in folders if folder.exists()), self.case(case))

    @property
    def manifest(self) -> Path:
        """Names of the cases in parts, and the hashes of their keys."""
        return self.data / "manifest.json"

    @property
    def keys(self) -> Path:
        """All that only the score may open."""
        return self.root / "keys" / self.suite

    @property
    def sealed(self) -> Path:
        return self.keys / "keys.sealed"

    @property
    def secret(self) -> Path:
        return self.keys / "secret"

    @property
    def examinations(self) -> Path:
        return self.root / "examinations" / self.suite

    @property
    def published(self) -> Path:
        """The manifest again, to be kept with the reports: made public before the diagnosis runs."""
        return self.root / "reports" / "sealed" / "manifests" / f"{self.suite}.json"

    @property
    def metrics(self) -> Path:
        return self.root / "reports" / "sealed" / f"{self.suite}.json"

    @property
    def history(self) -> Path:
        """The scores of every version of the diagnosis, of all suites."""
        return self.root / "reports" / "sealed" / "history.csv"

    @property
    def history_lock(self) -> Path:
        """Held while that table is changed."""
        return self.root / "data" / "sealed" / ".history.lock"

    @property
    def reports(self) -> Path:
        """The folder of the suite's latest report."""
        return self.root / "reports" / "sealed" / self.suite

    def report(self, code: str, round_: int) -> Path:
        """What came out for a version of the diagnosing code, in a round; it replaces the report of the last."""
        return self.reports / names.check(f"{code[:8]}-round-{round_}", "the report's folder")

    def examination(self, case: str) -> Path:
        """What is known of a case that was diagnosed."""
        return self.examinations / names.check(case, "a case")

    def statement(self, case: str) -> Path:
        """What was said of a case."""
        return self.examination(case) / "diagnosis.json"

    def experiment(self, case: str) -> Path:
        """The commands that its diagnosis prescribes, where it does."""
        return self.examination(case) / "experiment.csv"

    def record(self, case: str) -> Path:
        """Fingerprint, seconds and, if it failed, why."""
        return self.examination(case) / "record.json"
