"""Diagnose a simulator from Python, and load what a diagnosis left."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from simgap.diagnosis.diagnose import diagnose as find
from simgap.formats.diagnoses import MODEL, read_simulator, read_statement
from simgap.formats.purposes import Given, arranged, in_folder
from simgap.formats.recordings import checked
from simgap.loading.checks import check
from simgap.loading.load import load as load_simulator
from simgap.result import Result
from simgap.simulators.augmented import AugmentedSimulator
from simgap.types import ConfigError, Recording, RecordingError, Schema, StepModel

Columns = Mapping[str, Any]
"""A session as a table: a DataFrame of any library, or a dictionary of arrays, with the schema's columns."""
Recordings = str | PathLike[str] | Columns | Recording | Sequence[Columns | Recording] | Mapping[str, Columns]
"""A folder of sessions; one session; several, in a list, or by name in a dictionary."""


def diagnose(
    simulator: StepModel | str,
    recordings: Recordings,
    *,
    heldout: Recordings | None = None,
    baseline: Recordings | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Say what a simulator leaves out of recordings.

    simulator: an object with `schema`, `parameters`, `time_step` and `step`; or its name, `spot` or
    `package.module:name`. recordings: a folder, or sessions as tables with the schema's columns, `time_s` first.
    heldout: sessions to judge by; without them, every fourth of `recordings` is held out (the last of fewer).
    baseline: sessions from before the machine changed: the question is what changed since. progress: is called with
    every step, in words.

    Raises ConfigError for a simulator that cannot be used, RecordingError where recordings cannot be, and
    DivergenceError when the simulator leaves the finite numbers on them.
    """
    if isinstance(simulator, str):
        used, name = load_simulator(simulator), simulator
    else:
        used, name = simulator, _name_of(simulator)
        check(used, name)
    errors: list[str] = []
    given = {
        purpose: _given(purpose, some, used, errors)
        for purpose, some in (("recordings", recordings), ("heldout", heldout), ("baseline", baseline))
        if some is not None
    }
    sessions = arranged(used.schema, given["recordings"], given.get("heldout"), given.get("baseline"))
    found = find(used, name, sessions, seed, progress or (lambda _: None))
    return Result(used, found, tuple(errors))


def load(folder: str | PathLike[str], simulator: StepModel | None = None) -> AugmentedSimulator:
    """The simulator that a diagnosis in a folder corrected: with the effects that were found, and its fitted parameters
    as the nominal ones (`simgap.nominal`). It is a `StepModel`, as the simulator was.

    simulator: the one that was diagnosed, where its name in `diagnosis.json` does not lead to it.
    """
    statement = read_statement(Path(folder))
    used = load_simulator(statement["simulator"]) if simulator is None else simulator
    return read_simulator(Path(folder) / MODEL, used)


def _name_of(simulator: Any) -> str:
    """`package.module:name`, by which `load` finds it again, where its class's module has it; else the class's name."""
    kind = type(simulator)
    there = [n for n, value in vars(sys.modules[kind.__module__]).items() if value is simulator]
    return f"{kind.__module__}:{there[0]}" if there and kind.__module__ != "__main__" else kind.__name__


def _given(purpose: str, recordings: Recordings, simulator: StepModel, errors: list[str]) -> Given:
    """Sessions of one purpose, from wherever they are; `errors` gets why files of a folder are left out."""
    if isinstance(recordings, str | PathLike):
        return in_folder(Path(recordings), simulator, errors)
    sessions = [_session(name, some, simulator.schema) for name, some in _named(recordings)]
    if not sessions:
        raise RecordingError(f"{purpose}: no session is given. Give at least one, as a table or a folder.")
    return Given(sessions, purpose, purpose)


def _named(recordings: Any) -> Iterator[tuple[str, Any]]:
    """Sessions with their names; those without any are counted."""
    if isinstance(recordings, Recording):
        yield recordings.name, recordings
    elif _is_table(recordings):
        yield "session_1", recordings
    elif isinstance(recordings, Mapping):
        yield from recordings.items()
    elif isinstance(recordings, Sequence):
        for i, some in enumerate(recordings, 1):
            yield some.name if isinstance(some, Recording) else f"session_{i}", some
    else:
        raise ConfigError(
            f"recordings must be a folder, tables with the schema's columns, or a list or dictionary of such tables; "
            f"they are {type(recordings).__name__}."
        )


def _is_table(some: Any) -> bool:
    return hasattr(some, "columns") or (isinstance(some, Mapping) and "time_s" in some)


def _session(name: str, some: Any, schema: Schema) -> Recording:
    """A session, checked as one from a file is."""
    if isinstance(some, Recording):
        widths = [len(schema.state), len(schema.command)]
        rows = [np.asarray(part, float) for part in (some.state, some.command)]
        if [part.ndim for part in rows] != [2, 2] or [part.shape[1] for part in rows] != widths:
            raise RecordingError(
                f"session {name}: state and command must have {widths[0]} and {widths[1]} columns, as the schema; they "
                f"have the shapes {rows[0].shape} and {rows[1].shape}."
            )
        some = dict(zip(schema.columns, [some.time_s, *rows[0].T, *rows[1].T], strict=True))
    elif not _is_table(some):
        raise RecordingError(
            f"session {name}: must be a table with the columns {', '.join(schema.columns)}; it is "
            f"{type(some).__name__}."
        )
    there = list(some.columns) if hasattr(some, "columns") else list(some)
    columns = {c: np.asarray(some[c]) for c in schema.columns if c in there}
    lengths = {c: np.shape(values) for c, values in columns.items()}
    if any(len(shape) != 1 for shape in lengths.values()) or len(set(lengths.values())) > 1:
        raise RecordingError(f"session {name}: every column must be one row of numbers, all as long; they have the "
                             f"shapes {lengths}.")  # fmt: skip
    return checked(f"session {name}", schema, columns)._replace(name=str(name))
