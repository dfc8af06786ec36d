"""Named arrays as `.npz`."""

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from simgap.formats.atomic import replacing
from simgap.formats.documents import no_such_file
from simgap.types import SimgapError


def save_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays as `.npz`, uncompressed. Equal arrays give equal bytes; numpy would store the time."""
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.save(content, array, allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue())


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays that `save_arrays` wrote; SimgapError where the file is missing, damaged or of another kind."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):
            raise ValueError("it holds other things than arrays")
    except FileNotFoundError:
        raise no_such_file(path) from None
    except Exception as error:  # a damaged archive may raise anything
        raise SimgapError(
            f"{path}: is no whole file of arrays ({error}). Delete it and run the stage that writes it."
        ) from None
    return arrays
