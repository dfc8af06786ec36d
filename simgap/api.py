"""Diagnose a simulator from Python, and load the corrected simulator of a diagnosis."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from simgap.diagnosis.diagnose import diagnose as find
from simgap.engines import Engine
from simgap.formats import peek
from simgap.formats.diagnoses import MODEL, read_simulator, read_statement
from simgap.formats.peek import Look, Seen
from simgap.formats.purposes import Given, Purposes, in_folder, together
from simgap.formats.recordings import checked
from simgap.loading.arrange import arranged
from simgap.loading.checks import check
from simgap.loading.load import Used, prepared, started
from simgap.loading.load import load as load_simulator
from simgap.loading.model_files import ModelFile, named, recalled
from simgap.loading.seeds import check_seed
from simgap.result import Result
from simgap.simulators.augmented import AugmentedSimulator
from simgap.types import ConfigError, Recording, RecordingError, Schema, StepModel


class DataFrame(Protocol):
    """A table of any library."""

    @property
    def columns(self) -> Any: ...

    def __getitem__(self, key: Any, /) -> Any: ...


Columns = Mapping[str, Any] | DataFrame
"""A session as a table, or a dictionary of arrays, with the schema's columns."""
Folder = str | PathLike[str]
Recordings = Folder | Sequence[Folder] | Columns | Recording | Sequence[Columns | Recording] | Mapping[str, Columns]
"""One folder of sessions, or several; one session; several sessions in a list, or by name in a dictionary."""


def diagnose(
    simulator: StepModel | Engine | ModelFile | str | PathLike[str],
    recordings: Recordings,
    *,
    heldout: Recordings | None = None,
    baseline: Recordings | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Find what a simulator leaves out, by comparing it with recordings.

    simulator: an object with `schema`, `parameters`, `time_step` and `step`, or an `Engine`; or its name, `spot` or
    `package.module:name`; or the path of an MJCF or URDF, as it is or as a `ModelFile` with servos. recordings: a
    folder, or several of experiments with one machine, or sessions as tables with the schema's columns, `time_s` first.
    heldout: sessions for validation; without them, every fourth of `recordings` is held out (the last of fewer), or
    others, if these alone show something.
    baseline: sessions from before the machine changed; the diagnosis then finds what changed since. progress: is called
    with a line of text at every step.

    Raises ConfigError for a simulator or a seed that cannot be used, RecordingError for recordings that cannot be used,
    and DivergenceError if the simulator does not stay finite on them.
    """
    check_seed(seed)
    sources = {"recordings": recordings, "heldout": heldout, "baseline": baseline}
    sources = {purpose: source for purpose, source in sources.items() if source is not None}
    used = _used(simulator, list(sources.values()))
    errors: list[str] = []
    given = {purpose: _given(purpose, source, used.simulator, errors) for purpose, source in sources.items()}
    report = progress or (lambda _: None)
    used, sessions = arranged(used, Purposes(**given), report)
    used = started(used, sessions, report)
    # The search has threads of its own. Those of numpy would wait for them in every matrix product.
    with threadpool_limits(limits=1, user_api="blas"):
        diagnosis = find(used.simulator, used.name, sessions, seed, report)
    return Result.of(used, sessions, diagnosis, errors)


def load(
    folder: str | PathLike[str], simulator: StepModel | Engine | str | PathLike[str] | None = None
) -> AugmentedSimulator:
    """Load the corrected simulator of a diagnosis in a folder, a `StepModel`.

    It has the effects that were found; its nominal parameters (`simgap.nominal`) are the fitted ones. simulator: the
    one that was diagnosed, if the name or file in `diagnosis.json` does not lead to it.
    """
    statement = read_statement(Path(folder))
    used = _again(statement, simulator)
    return read_simulator(Path(folder) / MODEL, used)


def _again(statement: Mapping[str, Any], simulator: Any) -> StepModel | Engine:
    """The simulator of a diagnosis: the one given, else the one in the statement.

    For a model file, what the statement keeps of the recordings is used too.
    """
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
    """What the recordings of all purposes hold, for a model file."""
    looks: list[Look] = []
    for source in recordings:
        if folders := _folders(source):
            looks += [look for folder in folders for look in peek.in_folder(folder)]
            continue
        for name, table in _named(source):
            if not _is_table(table):
                raise RecordingError(f"session {name}: with a model file it must be a table, whose columns have names; "
                                     f"it is {type(table).__name__}.")  # fmt: skip
            looks.append(peek.of_table(table))
    return peek.seen(looks)


def _name_of(simulator: Any) -> str:
    """`package.module:name`, by which `load` finds it again, if its class's module holds it; else the class's name."""
    kind = type(simulator)
    names = [n for n, value in vars(sys.modules[kind.__module__]).items() if value is simulator]
    return f"{kind.__module__}:{names[0]}" if names and kind.__module__ != "__main__" else kind.__name__


def _given(purpose: str, recordings: Recordings, simulator: StepModel | Engine, errors: list[str]) -> Given:
    """Sessions of one purpose, from folders or tables; `errors` gets why files of a folder are left out."""
    if folders := _folders(recordings):
        return together([in_folder(folder, simulator, errors) for folder in folders])
    sessions = [_session(name, session, simulator.schema) for name, session in _named(recordings)]
    if not sessions:
        raise RecordingError(f"{purpose}: no session is given. Give at least one, as a table or a folder.")
    return Given(sessions, purpose, purpose)


def _folders(recordings: Recordings) -> list[Path]:
    """The folders, if recordings are given as folders; empty if they are tables."""
    if isinstance(recordings, str | PathLike):
        return [Path(recordings)]
    are_paths = isinstance(recordings, Sequence) and all(isinstance(path, str | PathLike) for path in recordings)
    return [Path(str(path)) for path in recordings] if are_paths else []


def _named(recordings: Any) -> Iterator[tuple[str, Any]]:
    """Sessions with their names; those without a name are numbered."""
    if isinstance(recordings, Recording):
        yield recordings.name, recordings
    elif _is_table(recordings):
        yield "session_1", recordings
    elif isinstance(recordings, Mapping):
        yield from recordings.items()
    elif isinstance(recordings, Sequence):
        for i, session in enumerate(recordings, 1):
            yield session.name if isinstance(session, Recording) else f"session_{i}", session
    else:
        raise ConfigError(
            f"recordings must be a folder, tables with the schema's columns, or a list or dictionary of such tables; "
            f"they are {type(recordings).__name__}."
        )


def _is_table(value: Any) -> bool:
    return hasattr(value, "columns") or (isinstance(value, Mapping) and "time_s" in value)


def _session(name: str, session: Any, schema: Schema) -> Recording:
    """A session, checked like one from a file."""
    if isinstance(session, Recording):
        widths = [len(schema.outputs), len(schema.command)]
        rows = [np.asarray(part, float) for part in (session.state, session.command)]
        if [part.ndim for part in rows] != [2, 2] or [part.shape[1] for part in rows] != widths:
            raise RecordingError(
                f"session {name}: state and command must have {widths[0]} and {widths[1]} columns, as in the schema; "
                f"they have the shapes {rows[0].shape} and {rows[1].shape}."
            )
        session = dict(zip(schema.columns, [session.time_s, *rows[0].T, *rows[1].T], strict=True))
    elif not _is_table(session):
        raise RecordingError(
            f"session {name}: must be a table with the columns {', '.join(schema.columns)}; it is "
            f"{type(session).__name__}."
        )
    names = list(session.columns) if hasattr(session, "columns") else list(session)
    columns = {c: np.asarray(session[c]) for c in schema.columns if c in names}
    lengths = {c: np.shape(values) for c, values in columns.items()}
    if any(len(shape) != 1 for shape in lengths.values()) or len(set(lengths.values())) > 1:
        raise RecordingError(f"session {name}: every column must be one series of numbers, all of the same length; "
                             f"they have the shapes {lengths}.")  # fmt: skip
    return checked(f"session {name}", schema, columns)._replace(name=str(name))
