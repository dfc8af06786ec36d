"""Diagnose a simulator from Python, and load what a diagnosis left."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from simgap.diagnosis.diagnose import diagnose as find
from simgap.engines import Engine
from simgap.formats import peek
from simgap.formats.diagnoses import MODEL, read_simulator, read_statement
from simgap.formats.peek import Look, Seen
from simgap.formats.purposes import Given, arranged, in_folder, together
from simgap.formats.recordings import checked
from simgap.loading.checks import check
from simgap.loading.load import Used, prepared, started
from simgap.loading.load import load as load_simulator
from simgap.loading.model_files import ModelFile, named, recalled
from simgap.loading.seeds import check_seed
from simgap.result import Result
from simgap.simulators.augmented import AugmentedSimulator
from simgap.types import ConfigError, Recording, RecordingError, Schema, StepModel

Columns = Mapping[str, Any]
"""A session as a table: a DataFrame of any library, or a dictionary of arrays, with the schema's columns."""
Folder = str | PathLike[str]
Recordings = Folder | Sequence[Folder] | Columns | Recording | Sequence[Columns | Recording] | Mapping[str, Columns]
"""A folder of sessions, or several; one session; several, in a list, or by name in a dictionary."""


def diagnose(
    simulator: StepModel | Engine | ModelFile | str | PathLike[str],
    recordings: Recordings,
    *,
    heldout: Recordings | None = None,
    baseline: Recordings | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Say what a simulator leaves out of recordings.

    simulator: an object with `schema`, `parameters`, `time_step` and `step`, or an `Engine`; or its name, `spot` or
    `package.module:name`; or the path of an MJCF or URDF, as it is or as a `ModelFile` with servos. recordings: a
    folder, or several of experiments with one machine, or sessions as tables with the schema's columns, `time_s` first.
    heldout: sessions to judge by; without them, every fourth of `recordings` is held out (the last of fewer).
    baseline: sessions from before the machine changed: the question is what changed since. progress: is called with
    every step, in words.

    Raises ConfigError for a simulator or a seed that cannot be used, RecordingError where recordings cannot be, and
    DivergenceError when the simulator leaves the finite numbers on them.
    """
    check_seed(seed)
    asked = {"recordings": recordings, "heldout": heldout, "baseline": baseline}
    asked = {purpose: some for purpose, some in asked.items() if some is not None}
    used = _used(simulator, list(asked.values()))
    errors: list[str] = []
    given = {purpose: _given(purpose, some, used.simulator, errors) for purpose, some in asked.items()}
    sessions = arranged(used.simulator.schema, given["recordings"], given.get("heldout"), given.get("baseline"))
    say = progress or (lambda _: None)
    used = started(used, sessions, say)
    found = find(used.simulator, used.name, sessions, seed, say)
    return Result.of(used, found, errors)


def load(
    folder: str | PathLike[str], simulator: StepModel | Engine | str | PathLike[str] | None = None
) -> AugmentedSimulator:
    """The simulator that a diagnosis in a folder corrected: with the effects that were found, and its fitted parameters
    as the nominal ones (`simgap.nominal`). It is a `StepModel`, as the simulator was.

    simulator: the one that was diagnosed, where its name or its file in `diagnosis.json` does not lead to it.
    """
    statement = read_statement(Path(folder))
    used = _again(statement, simulator)
    return read_simulator(Path(folder) / MODEL, used)


def _again(statement: Mapping[str, Any], simulator: Any) -> StepModel | Engine:
    """The simulator of a diagnosis: the one given, or the one that the statement remembers; of a model file given, what
    the recordings had is remembered too."""
    kept = statement.get("model_file")
    if kept and (simulator is None or isinstance(simulator, str | PathLike)):
        return recalled(kept if simulator is None else {**kept, "path": str(simulator)})
    if simulator is None or isinstance(simulator, str | PathLike):
        return load_simulator(str(simulator or statement["simulator"]))
    return simulator


def _used(simulator: Any, recordings: Sequence[Recordings]) -> Used:
    """The simulator, checked."""
    if isinstance(simulator, str | PathLike):
        simulator = named(str(simulator))
    if isinstance(simulator, str | ModelFile):
        return prepared(simulator, lambda: _seen(recordings))
    check(simulator, name := _name_of(simulator))
    return Used(simulator, name)


def _seen(recordings: Sequence[Recordings]) -> Seen:
    """What the recordings of all purposes have, for a model file."""
    looks: list[Look] = []
    for some in recordings:
        if folders := _folders(some):
            looks += [look for folder in folders for look in peek.in_folder(folder)]
            continue
        for name, table in _named(some):
            if not _is_table(table):
                raise RecordingError(f"session {name}: with a model file it must be a table, whose columns have names; "
                                     f"it is {type(table).__name__}.")  # fmt: skip
            looks.append(peek.of_table(table))
    return peek.seen(looks)


def _name_of(simulator: Any) -> str:
    """`package.module:name`, by which `load` finds it again, where its class's module has it; else the class's name."""
    kind = type(simulator)
    there = [n for n, value in vars(sys.modules[kind.__module__]).items() if value is simulator]
    return f"{kind.__module__}:{there[0]}" if there and kind.__module__ != "__main__" else kind.__name__


def _given(purpose: str, recordings: Recordings, simulator: StepModel | Engine, errors: list[str]) -> Given:
    """Sessions of one purpose, from wherever they are; `errors` gets why files of a folder are left out."""
    if folders := _folders(recordings):
        return together([in_folder(folder, simulator, errors) for folder in folders])
    sessions = [_session(name, some, simulator.schema) for name, some in _named(recordings)]
    if not sessions:
        raise RecordingError(f"{purpose}: no session is given. Give at least one, as a table or a folder.")
    return Given(sessions, purpose, purpose)


def _folders(recordings: Recordings) -> list[Path]:
    """The folders that recordings are given as; none where they are tables."""
    if isinstance(recordings, str | PathLike):
        return [Path(recordings)]
    some = isinstance(recordings, Sequence) and all(isinstance(each, str | PathLike) for each in recordings)
    return [Path(str(each)) for each in recordings] if some else []


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
        widths = [len(schema.outputs), len(schema.command)]
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
