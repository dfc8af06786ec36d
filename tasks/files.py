"""The one door to data files: recordings in, every stage's results out and back in.

What is written is whole or not there at all, and equal content makes equal bytes, so that caches and digests hold.
"""

import csv
import hashlib
import io
import json
import math
import os
import pickle
import shutil
import socket
import zipfile
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, TextIO
from uuid import uuid4

import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float

from simgap.effects.effect import Scales
from simgap.effects.regime import Acting, Regime
from simgap.models import BNN, FittedSimulator, FittedSpot, Model
from simgap.policies.actor import Actor
from simgap.recordings import Normalisation, check_recording
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.spot import Spot
from simgap.types import MOST_ROWS, Field, Recording, RecordingError, Schema, SimgapError
from tasks.sessions import session_files

ROW_LIMIT = 2**20
"""Most characters in a row of a CSV file: some ten thousand columns."""
LARGEST = float(np.sqrt(np.finfo(np.float32).max / MOST_ROWS))
"""Greatest size of a value: the squares of a session's values have a finite sum in single precision, which the
diagnosis and the learning compute in."""
PICKLE_LIMIT = 64 * 2**20
"""Greatest size of a pickle that is opened [bytes]; the published ones stay below 0.2 MB."""

_Columns = dict[str, Float[np.ndarray, " T"]]
_OWNER = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]
"""Begins the names of files that are being written: on a shared disk, processes of other machines write too."""
_SHOWN = 20  # files that are named where none can be used
_TEXT_SHOWN = 40  # characters of a file's own text in a message


# Recordings


def read_recordings(
    folder: Path, schema: Schema, time_step: float, patterns: Sequence[str] = ("**/*",)
) -> tuple[list[Recording], list[RecordingError]]:
    """Every session under `folder` that matches a glob pattern, by relative path, and why others cannot be used.

    A session is a CSV, Parquet or pickle file; its name is its path in the folder without the suffix. `time_step` [s]
    lies between the rows of pickles, which have no time stamps. An error names file, column, row and remedy; it leaves
    the other sessions alone. Raises RecordingError when the folder has no usable session at all.
    """
    recordings: list[Recording] = []
    errors: list[RecordingError] = []
    seen: dict[str, Path] = {}
    paths = session_files(folder, patterns)
    for path in paths:
        name = session_name(folder, path)
        try:
            if name in seen:
                raise RecordingError(
                    f"{path}: the session {name} is in {seen[name]} already; a session is one file. "
                    "Remove or rename one of the two."
                )
            seen[name] = path
            recordings.append(checked(path, schema, _columns(path, schema, time_step))._replace(name=name))
        except RecordingError as error:
            errors.append(RecordingError(printable(str(error))))
    if not recordings:
        reasons = "\n".join(f"  {error}" for error in errors[:_SHOWN])
        more = f"\n  and {len(errors) - _SHOWN} more" if len(errors) > _SHOWN else ""
        raise RecordingError(
            printable(f"{folder}: none of its {len(paths)} session files can be used:\n{reasons}{more}")
        )
    return recordings, errors


class _WithoutCommands(Schema):
    """The schema of a machine without commands, as `check_recording` takes it: with one, of which no file has a column.

    `simgap.recordings` has no case for it, as a change there makes every trained model stale.
    """

    @property
    def columns(self) -> tuple[str, ...]:
        return ("time_s", *(f.name for f in self.state))


def checked(path: Path, schema: Schema, columns: _Columns) -> Recording:
    """Columns as a recording that can be computed with; RecordingError that names file, column, row and remedy."""
    if schema.command:
        recording = check_recording(schema, str(path), columns)
    else:
        recording = check_recording(_WithoutCommands(schema.state, schema.state[:1], schema.mounts), str(path), columns)
        recording = recording._replace(command=np.empty((len(recording.time_s), 0)))
    for name in schema.columns:
        beyond = np.flatnonzero(np.abs(columns[name]) > LARGEST)
        if beyond.size:
            raise RecordingError(
                f"{path}: column {name}, row {beyond[0] + 1} is {columns[name][beyond[0]]:g}; no value may exceed "
                f"{LARGEST:.1e}, or its square is lost in single precision ({beyond.size} such rows). Look for a wrong "
                "unit or a damaged value; convert the column, or cut the session there."
            )
    return recording


def printable(text: str) -> str:
    """A text that can be printed and written: what of a file's name is no UTF-8 as `\\udcff`."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def session_name(folder: Path, path: Path) -> str:
    """A session's name: its path below the folder without the suffix, printable."""
    return printable(path.relative_to(folder).with_suffix("").as_posix())


def write_recording(folder: Path, recording: Recording, schema: Schema) -> Path:
    """Write a session as Parquet in the documented format, at its name below `folder`; returns the path.

    Columns are those of the schema as 64-bit floats, in the schema's units. Raises RecordingError when the name would
    leave the folder.
    """
    path = folder / f"{_relative_name(recording.name)}.parquet"
    values = np.column_stack([recording.time_s, recording.state, recording.command]).astype(np.float64)
    table = pa.table(dict(zip(schema.columns, values.T, strict=True)))
    with _replacing(path) as temporary:
        # The checksum tells a damaged value from a measured one when the file is read.
        pq.write_table(table, temporary, write_page_checksum=True)
    return path


def session_names(folder: Path) -> list[str]:
    """Names of the sessions under a folder, whether they can be used or not."""
    return [session_name(folder, path) for path in session_files(folder)]


def _relative_name(name: str) -> str:
    """The session's name, which becomes a path; RecordingError when that would not lie in the folder or read back."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or not path.parts or str(path) != name or "\0" in name:
        raise RecordingError(
            f"The session name {name!r} must be a relative path like `day_1/walk`, without `..`: it becomes a file in "
            "the recordings' folder. Rename the session."
        )
    return name


def _columns(path: Path, schema: Schema, time_step: float) -> _Columns:
    """The schema's columns that the file has, as numbers."""
    try:
        if not path.is_file():
            raise OSError("it is no regular file, or a link to nothing")
        if path.suffix.lower() == ".csv":
            return _csv_columns(path, schema)
        if path.suffix.lower() == ".parquet":
            return _parquet_columns(path, schema)
        return _pickle_columns(path, schema, time_step)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error}). Mend or remove the file.") from None


def read_table(path: Path, columns: Sequence[str]) -> _Columns:
    """Columns of a CSV or Parquet file as numbers, blanks as NaN; RecordingError names file, column and row."""
    schema = Schema(state=(), command=tuple(Field(name, "", "position", "world") for name in columns))
    try:
        found = _csv_columns(path, schema) if path.suffix.lower() == ".csv" else _parquet_columns(path, schema)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error}). Mend or remove the file.") from None
    missing = [name for name in columns if name not in found]
    if missing:
        raise RecordingError(f"{path}: column {', '.join(missing)} is missing. Mend the mapping file, or leave it out.")
    return found


def _too_many(path: Path) -> RecordingError:
    return RecordingError(
        f"{path}: has more than {MOST_ROWS:,} rows, the most of a session. Split it, or lower its rate."
    )


def _refuse_duplicates(path: Path, header: Sequence[str], schema: Schema) -> None:
    for name in schema.columns:
        if header.count(name) > 1:
            raise RecordingError(
                f"{path}: column {name} stands {header.count(name)} times in the header; every column must be there "
                "once. Remove or rename the others."
            )


# Recordings: CSV


def _csv_columns(path: Path, schema: Schema) -> _Columns:
    """The schema's columns as numbers. A row is forgotten once its numbers are read: memory is 8 bytes a number."""
    rows = _csv_rows(path)
    header = [name.strip() for name in next(rows, [])]
    if not header:
        raise RecordingError(
            f"{path}: is empty, or its first line is; it must begin with the columns' names. "
            "Add the header, or leave the file out."
        )
    _refuse_separators(path, header, schema)
    _refuse_duplicates(path, header, schema)
    numbers = {i: (name, array("d")) for i, name in enumerate(header) if name in schema.columns}
    for number, row in enumerate(rows, 1):
        if number > MOST_ROWS:
            raise _too_many(path)
        if len(row) != len(header):
            where = (
                f"{header[len(row)]} is the first without" if len(row) < len(header) else f"{header[-1]} is the last"
            )
            raise RecordingError(
                f"{path}: row {number} has {len(row)} values for {len(header)} columns; column {where}. "
                "Mend the row, or cut the session there."
            )
        for i, (name, values) in numbers.items():
            values.append(_number(path, name, number, row[i]))
    return {name: np.array(values) for name, values in numbers.values()}


def _csv_rows(path: Path) -> Iterator[list[str]]:
    """Header and rows of a CSV file as text; a byte order mark and blank lines at the end do no harm."""
    room = ROW_LIMIT

    def lines(file: TextIO) -> Iterator[str]:
        nonlocal room
        while line := file.readline(room + 1):
            room -= len(line)
            if room < 0:
                raise RecordingError(
                    f"{path}: a row has more than {ROW_LIMIT:,} characters, {line[:_TEXT_SHOWN]!r}... . Save it as "
                    "CSV, a line a row, or leave the file out."
                )
            yield line

    blank = 0
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for row in csv.reader(lines(file)):
                room = ROW_LIMIT
                if not row:
                    blank += 1
                    continue
                yield from ([] for _ in range(blank))
                blank = 0
                yield row
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: is no UTF-8 text ({error}). Save it as CSV in UTF-8.") from None
    except csv.Error as error:
        raise RecordingError(f"{path}: is no CSV ({error}). Save it with commas between the values.") from None


def _refuse_separators(path: Path, header: Sequence[str], schema: Schema) -> None:
    for mark, word in ((";", "semicolons"), ("\t", "tabs")):
        names = {name.strip().strip('"') for cell in header for name in cell.split(mark)}
        if names & set(schema.columns) - set(header):
            raise RecordingError(
                f"{path}: the header has {word} between the columns; there must be commas, and a point before "
                "the decimals. Save it so."
            )


def _number(path: Path, column: str, row: int, text: str) -> float:
    """A text as a number, a blank as NaN; RecordingError where it is neither."""
    try:
        if "_" in text:  # python reads 1_000 as a number; in a table it is a slip
            raise ValueError
        return float(text) if text.strip() else math.nan
    except ValueError:
        raise RecordingError(
            f"{path}: column {column}, row {row} holds the text {text[:_TEXT_SHOWN]!r}; every value must be a "
            "number, with a point before the decimals. Replace the text, or cut the session there."
        ) from None


# Recordings: Parquet


def _parquet_columns(path: Path, schema: Schema) -> _Columns:
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            if file.metadata.num_rows > MOST_ROWS:
                raise _too_many(path)
            names = file.schema_arrow.names
            _refuse_duplicates(path, names, schema)
            table = file.read([name for name in schema.columns if name in names])
    except (pa.ArrowException, OSError, ValueError) as error:
        raise RecordingError(
            f"{path}: is no whole Parquet file ({error}). Write or copy it again, or leave it out."
        ) from None
    return {name: _arrow_numbers(path, name, table.column(name)) for name in table.column_names}


def _arrow_numbers(path: Path, name: str, column: pa.ChunkedArray) -> Float[np.ndarray, " T"]:
    """A column of numbers, nulls as NaN; RecordingError for any other type."""
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        first = f", in row 1 {str(column[0].as_py())[:_TEXT_SHOWN]!r}" if len(column) else ""
        raise RecordingError(
            f"{path}: column {name} holds values of type {column.type}{first}; every value must be a number, in the "
            "unit of the schema. Convert the column."
        )
    return column.to_numpy().astype(np.float64)


# Recordings: pickles as published with [Hoffman et al. 2025]


def _pickle_columns(path: Path, schema: Schema, time_step: float) -> _Columns:
    """A pickled (x[T,s], u[T,u], y[T,s]): state, command, next state, one `time_step` [s] between rows.

    T + 1 rows keep all T transitions: the states x and after them the last next state. The last row's command repeats
    the one before; it is never part of a transition, because the last row has no successor.
    """
    size = path.stat().st_size
    if size > PICKLE_LIMIT:
        raise RecordingError(
            f"{path}: the pickle has {size:,} bytes; at most {PICKLE_LIMIT:,} are opened. "
            "Split the session, or convert it to Parquet."
        )
    x, u, y = _unpickle(path, schema)
    _refuse_gap(path, schema, x, y)
    state, command = np.concatenate([x, y[-1:]]), np.concatenate([u, u[-1:]])
    values = np.column_stack([np.arange(len(state)) * time_step, state, command])
    return dict(zip(schema.columns, values.T, strict=True))


def _refuse_gap(path: Path, schema: Schema, x: Float[np.ndarray, "T s"], y: Float[np.ndarray, "T s"]) -> None:
    gaps = np.argwhere(~np.isclose(y[:-1], x[1:], rtol=0, atol=0, equal_nan=True))
    if len(gaps):
        t, i = gaps[0]
        raise RecordingError(
            f"{path}: column {schema.state[i].name}, row {t + 1} has the next state {y[t, i]} and row {t + 2} the "
            f"state {x[t + 1, i]}; they must be equal, the session must have no gap. Split it after row {t + 1}."
        )


def _unpickle(path: Path, schema: Schema) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The three arrays, in the schema's shapes; RecordingError for anything else, before any of it is run."""
    try:
        arrays = _ArraysOnly(path).load()
        if not (isinstance(arrays, tuple) and all(isinstance(array, _PickledArray) for array in arrays)):
            raise ValueError("other things than arrays")
        x, u, y = (array.values for array in arrays)
    except RecordingError:
        raise
    except Exception as error:  # a damaged pickle may raise anything
        raise RecordingError(
            f"{path}: is no pickle of three float32 arrays, state, command and next state "
            f"({type(error).__name__}: {error}). Copy it again, or leave it out."
        ) from None
    rows, s, c = x.shape[:1], len(schema.state), len(schema.command)
    if not (x.shape == y.shape == (*rows, s) and u.shape == (*rows, c)):
        raise RecordingError(
            f"{path}: the arrays have the shapes {x.shape}, {u.shape}, {y.shape}; state, command and next state must "
            f"have (T, {s}), (T, {c}), (T, {s}). Leave the file out, or use the schema of its robot."
        )
    return x, u, y


class _PickledType:
    """Stands in for numpy's dtype: little or big endian float32, nothing else."""

    def __init__(self, code: str, _align: bool, _copy: bool) -> None:
        if code != "f4":
            raise ValueError(f"numbers of type {code!r}")
        self.value = np.dtype(np.float32)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.value = self.value.newbyteorder(state[1])


class _PickledArray:
    """Stands in for numpy's array: takes shape, type and bytes from the pickle, and builds the array itself."""

    values: np.ndarray

    def __init__(self, *_: object) -> None:
        pass

    def __setstate__(self, state: tuple[int, tuple[int, ...], _PickledType, bool, bytes]) -> None:
        _, shape, dtype, fortran, content = state
        self.values = np.frombuffer(content, dtype.value).reshape(shape, order="F" if fortran else "C")


class _PickledJaxArray(_PickledArray):
    """Stands in for the function that rebuilds a jax array, from what makes a numpy array and that array's state."""

    def __init__(self, _function: object, _arguments: object, state: Any, _jax_state: object) -> None:
        self.__setstate__(state)


_STAND_INS = {
    ("jax._src.array", "_reconstruct_array"): _PickledJaxArray,
    ("numpy.core.multiarray", "_reconstruct"): _PickledArray,
    ("numpy", "ndarray"): _PickledArray,
    ("numpy", "dtype"): _PickledType,
}


class _ArraysOnly(pickle.Unpickler):
    """Admits the four globals that the published files refer to.

    Each has a stand-in: numpy's own array and dtype believe what a pickle tells them about memory.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(io.BytesIO(path.read_bytes()))
        self._path = path

    def find_class(self, module: str, name: str) -> type:
        """The stand-in of an admitted global; RecordingError that names any other."""
        if (module, name) not in _STAND_INS:
            raise RecordingError(
                f"{self._path}: the pickle wants to run code, {f'{module}.{name}'!r}, and was not loaded; it may hold "
                "three jax arrays only. Convert it to CSV or Parquet where you trust it, or leave it out."
            )
        return _STAND_INS[module, name]


# Results of stages


SCALES = "scales_"


def save_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays as `.npz`, uncompressed. Equal arrays make equal bytes; numpy's own would hold the time."""
    with _replacing(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.save(content, array, allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue())


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays that `save_arrays` wrote; SimgapError when the file is missing, damaged or of another kind."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):
            raise ValueError("it holds other things than arrays")
    except FileNotFoundError:
        raise SimgapError(_missing(path)) from None
    except Exception as error:  # a damaged archive may raise anything
        raise SimgapError(
            f"{path}: is no whole file of arrays ({error}). Delete it and run the stage that writes it."
        ) from None
    return arrays


def save_model(path: Path, model: Model) -> None:
    """Write a model as `.npz`: its `kind` and its arrays by name, the layers' as `weight_0`, `bias_0`, `weight_1`..."""
    if isinstance(model, BNN):
        layers = {
            f"{part}_{i}": array
            for i, layer in enumerate(model.particles)
            for part, array in zip(("weight", "bias"), layer, strict=True)
        }
        arrays = {**layers, "scale": model.scale, "dof": model.dof, **model.normalisation._asdict()}
    elif isinstance(model, FittedSimulator):
        arrays = {"params": model.params, "scale": model.scale, "dof": model.dof,
                  **augmented_arrays(_augmented_spot(model.simulator))}  # fmt: skip
    else:
        arrays = model._asdict()
    kind = type(model).__name__
    save_arrays(path, {name: np.asarray(array) for name, array in {"kind": kind, **arrays}.items()})


def load_model(path: Path) -> Model:
    """The model that `save_model` wrote, bit for bit, its arrays numpy's; SimgapError when the file holds none."""
    arrays = load_arrays(path)
    kind = str(arrays.pop("kind", "none"))
    try:
        if kind == FittedSpot.__name__:
            return FittedSpot(**arrays)  # type: ignore[arg-type]  # numpy's arrays serve as jax's
        if kind == FittedSimulator.__name__:
            return FittedSimulator(augmented_spot(arrays), **arrays)  # type: ignore[arg-type]  # as above
        if kind == BNN.__name__:
            return _bnn(arrays)
    except (KeyError, TypeError, ValueError) as error:
        raise SimgapError(
            f"{path}: a {kind} with other arrays than this version's ({error}). Train the model again."
        ) from None
    raise SimgapError(
        f"{path}: holds no model; its kind is {kind[:_TEXT_SHOWN]!r} and must be {BNN.__name__}, "
        f"{FittedSpot.__name__} or {FittedSimulator.__name__}. Give a file of the stage `train`."
    )


def _bnn(arrays: dict[str, np.ndarray]) -> BNN:
    """Takes all of the arrays; KeyError or TypeError when one is missing or left over."""
    layers = max(1, sum(name.startswith("weight_") for name in arrays))
    particles = [(arrays.pop(f"weight_{i}"), arrays.pop(f"bias_{i}")) for i in range(layers)]
    stats = Normalisation(*(arrays.pop(name) for name in Normalisation._fields))  # type: ignore[arg-type]
    return BNN(particles, normalisation=stats, **arrays)  # type: ignore[arg-type]


def save_policy(path: Path, policy: Actor) -> None:
    """Write a policy as `.npz`: `weight_0`, `bias_0`, `weight_1`..., `mean` and `std` of observations, its `limit`."""
    layers = {
        f"{part}_{i}": array
        for i, layer in enumerate(policy.layers)
        for part, array in zip(("weight", "bias"), layer, strict=True)
    }
    arrays = {"kind": Actor.__name__, **layers, "mean": policy.mean, "std": policy.std, "limit": policy.limit}
    save_arrays(path, {name: np.asarray(array) for name, array in arrays.items()})


def load_policy(path: Path) -> Actor:
    """The policy that `save_policy` wrote, bit for bit, its arrays numpy's; SimgapError when the file holds none."""
    arrays = load_arrays(path)
    kind = str(arrays.pop("kind", "none"))
    try:
        if kind != Actor.__name__:
            raise ValueError(f"its kind is {kind[:_TEXT_SHOWN]!r}")
        count = sum(name.startswith("weight_") for name in arrays)
        layers = [(arrays.pop(f"weight_{i}"), arrays.pop(f"bias_{i}")) for i in range(count)]
        return Actor(layers, **arrays)  # type: ignore[arg-type]  # numpy's arrays serve as jax's
    except (KeyError, TypeError, ValueError) as error:
        raise SimgapError(f"{path}: holds no policy of this version ({error}). Run the stage `policy`.") from None


def augmented_arrays(simulator: AugmentedSimulator) -> dict[str, np.ndarray]:
    """The effects' constants, what they refer to (`scales_<name>`) and the time step [s], as `augmented_spot` reads."""
    return {**acting_arrays(simulator.acting), "time_step": np.asarray(simulator.time_step, np.float64),
            **scale_arrays(simulator.scales)}  # fmt: skip


def augmented_spot(arrays: dict[str, np.ndarray]) -> AugmentedSimulator:
    """The Spot with effects that `augmented_arrays` wrote, whose arrays are taken out; KeyError if one is missing."""
    scales, spot = pop_scales(arrays), Spot(time_step=float(arrays.pop("time_step")))
    return AugmentedSimulator.of(spot, pop_acting(arrays), scales)


def acting_arrays(acting: Acting) -> dict[str, np.ndarray]:
    """Effects' constants and the regime in which they are others, as `pop_acting` reads them."""
    return {name: np.asarray(value) for name, value in acting._asdict().items()}


def pop_acting(arrays: dict[str, np.ndarray]) -> Acting:
    """The constants among `arrays`, which are taken out; KeyError if one is missing."""
    theta, delta, regimes = (arrays.pop(name) for name in Acting._fields)
    return Acting(theta, delta, tuple(Regime(int(f), float(side), float(edge)) for f, side, edge in regimes))


def scale_arrays(scales: Scales) -> dict[str, np.ndarray]:
    """What effects' constants refer to, as `pop_scales` reads it."""
    return {f"{SCALES}{name}": np.asarray(value) for name, value in scales._asdict().items()}


def pop_scales(arrays: dict[str, np.ndarray]) -> Scales:
    """The scales among `arrays`, which are taken out; KeyError if one is missing."""
    scales = {name: arrays.pop(f"{SCALES}{name}") for name in Scales._fields}
    return Scales(**{name: float(v) if v.ndim == 0 else v for name, v in scales.items()})  # type: ignore[arg-type]


def _augmented_spot(simulator: object) -> AugmentedSimulator:
    if isinstance(simulator, AugmentedSimulator) and type(simulator.simulator) is Spot:
        return simulator
    raise SimgapError(f"a model of {simulator} cannot be written; it must be one of a Spot with diagnosed effects.")


def write_json(path: Path, value: Any) -> None:
    """Write as JSON, keys sorted; arrays as lists, and null for numbers that are not finite, which JSON has not."""
    write_text(path, json.dumps(_plain(value), indent=1, sort_keys=True, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_json(path: Path) -> Any:
    """What a JSON file holds; SimgapError when it is missing or damaged."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise SimgapError(_missing(path)) from None
    except (OSError, ValueError, RecursionError) as error:
        raise SimgapError(
            f"{path}: is no whole JSON file ({error}). Delete it and run the stage that writes it."
        ) from None


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8."""
    with _replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_bytes(path: Path, content: bytes, private: bool = False) -> None:
    """Bytes as they are; `private`: for the owner's eyes alone."""
    with _replacing(path) as temporary:
        temporary.touch(0o600 if private else 0o644)
        temporary.write_bytes(content)


def read_bytes(path: Path) -> bytes:
    """A file's bytes; SimgapError where there is none."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise SimgapError(_missing(path)) from None


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV, floats with 6 significant digits; a key that a row has not is left blank there."""
    header = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, header, lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: _cell(value) for key, value in row.items()} for row in rows)
    write_text(path, text.getvalue())


def _cell(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float | np.floating) else value


def digest(paths: Sequence[Path]) -> str:
    """16 hexadecimal digits that identify files by content and by path below the folder they share.

    SHA-256, the same for a copy of the files elsewhere and in any order. Raises SimgapError when one is missing.
    """
    shared = os.path.commonpath([path.parent for path in paths])
    total = hashlib.sha256()
    for name, path in sorted((path.relative_to(shared).as_posix(), path) for path in paths):
        try:
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256")
        except FileNotFoundError:
            raise SimgapError(_missing(path)) from None
        total.update(name.encode() + b"\0" + content.digest())
    return total.hexdigest()[:16]


def fingerprint_of(record: Path, arrays: Path) -> str | None:
    """The fingerprint that a record has, if it and the arrays that it is of are there and whole."""
    try:
        load_arrays(arrays)
        return read_json(record).get("fingerprint")
    except (SimgapError, AttributeError):
        return None


def make_folder(folder: Path) -> None:
    """Make a folder, if it is not there, and see that it can be written to; SimgapError that says why not."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError("it is not writable")
    except OSError as error:
        raise SimgapError(
            f"{folder}: must be a folder that can be written to ({error}). Give another one, or mend its permissions."
        ) from None


def keep_private(path: Path) -> None:
    """Create an empty database if there is none, and take from others the right to read it and what SQLite keeps with
    it; SimgapError where its folder cannot be written to.

    SQLite gives the files that it adds later the rights of the database. One that is there is not opened: closing it
    would end the locks that this process holds on it.
    """
    make_folder(path.parent)
    with suppress(OSError):  # another user's database, or a read-only disk: who opens it next says so
        if not path.exists():
            os.close(os.open(path, os.O_CREAT | os.O_EXCL, 0o600))
        for each in (path, *path.parent.glob(f"{path.name}-*")):
            each.chmod(0o600)


def remove_unfinished(folder: Path) -> None:
    """Delete what processes of this machine that are gone were writing in a folder when they were killed."""
    for path in list(folder.rglob(f".{_OWNER}-*.tmp")):
        if not psutil.pid_exists(int(path.name.split("-")[1])):
            (remove_folder if path.is_dir() else remove_file)(path, folder)


def remove_folder(folder: Path, within: Path) -> None:
    """Delete a folder with all that is in it, if it is there; of links in it, the links alone.

    Raises SimgapError, and deletes nothing, where it does not lie in the folder `within` once links are followed; and
    where a part of it cannot be deleted: the message names the part and why.
    """
    if not os.path.lexists(folder):
        return
    _refuse_outside(folder.resolve(), folder, within)
    failed: list[tuple[str, BaseException]] = []
    shutil.rmtree(folder, onerror=lambda _, path, error: failed.append((path, error[1])))
    if failed:
        (path, error), more = failed[0], len(failed) - 1
        raise SimgapError(
            f"{folder}: {path} cannot be deleted ({getattr(error, 'strerror', None) or error})"
            f"{f', nor {more} others' if more else ''}. Fix the permissions of the folder that it lies in, or end the "
            "program that uses it, and start again."
        )


def remove_file(path: Path, within: Path) -> None:
    """Delete a file, if it is there; of a link, the link alone. SimgapError as `remove_folder` has it."""
    if not os.path.lexists(path):
        return
    _refuse_outside(path.parent.resolve() / path.name, path, within)
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise SimgapError(
            f"{path}: cannot be deleted ({error.strerror or error}). Fix the permissions of the folder that it lies "
            "in, and start again."
        ) from None


def _refuse_outside(place: Path, path: Path, within: Path) -> None:
    """SimgapError unless `place`, where `path` leads, lies below the folder `within`."""
    if within.resolve() not in place.parents:
        raise SimgapError(
            f"{path}: leads to {place}, which does not lie in {within.resolve()}. Only what lies in there is deleted; "
            "nothing was. Replace the link by a folder, or give another name."
        )


def _missing(path: Path) -> str:
    return f"{path}: there is no such file. Run the stage that writes it."


@contextmanager
def replacing_folder(folder: Path) -> Iterator[Path]:
    """A new folder beside `folder` to write to, which takes its place whole when all went well and is deleted
    otherwise."""
    new, old = _beside(folder), _beside(folder)
    try:
        make_folder(new)
        yield new
        if folder.exists():
            os.replace(folder, old)
        os.replace(new, folder)
    finally:
        remove_folder(new, folder.parent)
        remove_folder(old, folder.parent)


def _beside(path: Path) -> Path:
    return path.with_name(f".{_OWNER}-{os.getpid()}-{uuid4().hex}.tmp")


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to, which takes its place when all went well and is deleted otherwise."""
    temporary = _beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise SimgapError(
            f"{path}: cannot be written ({error.strerror or error}). Make room, or mend the folder's permissions, and "
            "start again: what is finished is not repeated."
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
