"""Pickled sessions as published with [Hoffman et al. 2025, Data Collection], opened without running code in them."""

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from simgap.formats.tables import Columns
from simgap.types import RecordingError, Schema

PICKLE_LIMIT = 64 * 2**20
"""Maximum size of a pickle that is opened [bytes]; the published ones are below 0.2 MB."""


def pickle_columns(path: Path, schema: Schema, time_step: float) -> Columns:
    """A pickled (x[T,s], u[T,u], y[T,s]): state, command, next state, with `time_step` [s] between rows.

    T + 1 rows keep all T transitions: the states x, followed by the last next state. The command of the last row
    repeats the one before; it is in no transition, because the last row has no successor.
    """
    size = path.stat().st_size
    if size > PICKLE_LIMIT:
        raise RecordingError(
            f"{path}: the pickle has {size:,} bytes; at most {PICKLE_LIMIT:,} are opened. "
            "Split the session, or convert it to Parquet."
        )
    schema = schema.measured
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
    """The three arrays, in the schema's shapes; RecordingError for anything else, without running it."""
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
    """Stands in for the function that rebuilds a jax array, from the arguments and the state of a numpy array."""

    def __init__(self, _function: object, _arguments: object, state: Any, _jax_state: object) -> None:
        self.__setstate__(state)


_STAND_INS = {
    ("jax._src.array", "_reconstruct_array"): _PickledJaxArray,
    ("numpy.core.multiarray", "_reconstruct"): _PickledArray,
    ("numpy", "ndarray"): _PickledArray,
    ("numpy", "dtype"): _PickledType,
}


class _ArraysOnly(pickle.Unpickler):
    """Admits only the four globals that the published files refer to.

    Each has a stand-in, as numpy's own array and dtype trust what a pickle says about memory.
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
