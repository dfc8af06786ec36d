"""Where a sealed suite's files lie: recordings, keys apart from them, what was said, and the report."""

from dataclasses import dataclass
from pathlib import Path

EXAMINATION = "examination"
SUITES = ("development", EXAMINATION, "engine", "real")
BEFORE, AFTER = "before", "after"
"""Folders of a case whose question is what changed."""


@dataclass(frozen=True)
class SealedWorkspace:
    """The folders of one suite under `root`."""

    root: Path
    suite: str

    @property
    def data(self) -> Path:
        return self.root / "data" / "sealed" / self.suite

    @property
    def cases(self) -> Path:
        """A recording set a case."""
        return self.data / "cases"

    def recordings(self, case: str) -> Path:
        """A case's sessions; those after, where there are some from before a change."""
        after = self.cases / case / AFTER
        return after if after.exists() else self.cases / case

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

    def report(self, code: str, round_: int) -> Path:
        """What came out for a version of the diagnosing code, in a round; the reports of others stay."""
        return self.root / "reports" / "sealed" / self.suite / f"{code[:8]}-round-{round_}"

    def statement(self, case: str) -> Path:
        """What was said of a case."""
        return self.examinations / case / "diagnosis.json"

    def record(self, case: str) -> Path:
        """Fingerprint, seconds and, if it failed, why."""
        return self.examinations / case / "record.json"
