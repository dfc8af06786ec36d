"""Sessions as files of the documented format, of which neither name nor size says anything but the number of rows."""

import os
from pathlib import Path

import numpy as np

from concealed.form import Array
from concealed.plain import COMMAND, STATE, TIME_STEP

COLUMNS = ("time_s", *STATE, *COMMAND)
EPOCH = 946_684_800
"""Time stamp of every file [s]: when it was made is nobody's business."""


def write(folder: Path, measured: Array, command: Array) -> None:
    """A CSV a session, `a.csv` to `h.csv`; all numbers as wide as each other."""
    folder.mkdir(parents=True)
    for s in range(len(measured)):
        rows = np.column_stack([np.arange(measured.shape[1]) * TIME_STEP, measured[s], command[s]])
        path = folder / f"{chr(ord('a') + s)}.csv"
        with path.open("w") as file:
            file.write(",".join(COLUMNS) + "\n")
            np.savetxt(file, np.clip(rows, -9999, 9999), fmt="%+012.6f", delimiter=",")
        os.utime(path, (EPOCH, EPOCH))
    os.utime(folder, (EPOCH, EPOCH))


def read(folder: Path) -> tuple[Array, Array]:
    """What `write` wrote: measured states [S, T, 12] and commands [S, T, 6]."""
    tables = [np.loadtxt(path, delimiter=",", skiprows=1) for path in sorted(folder.glob("*.csv"))]
    table = np.stack(tables)
    return table[:, :, 1:13], table[:, :, 13:]
