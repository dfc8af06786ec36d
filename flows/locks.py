"""A run's folder, and in it what belongs to a source, belong to one command at a time."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from simgap.cli import locks
from simgap.cli.locks import held
from tasks.workspace import Workspace


@contextmanager
def alone(root: Path, source: str) -> Iterator[None]:
    """Hold a run's folder and what belongs to a source in it; SimgapError where another process works there."""
    with locks.alone(root), held(Workspace(root, source).lock):
        yield
