"""Sessions as files of the documented format, of which neither name nor size says anything but the number of rows."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from concealed.form import Array
from concealed.plain import COMMAND, STATE, TIME_STEP

EPOCH = 946_684_800
"""Time stamp of every file [s]: when it was made is nobody's business."""
MODEL, SIMULATOR = "robot.xml", "simulator.txt"
"""The model that the user of a machine has, or the name of its simulator, in the folder of its sessions."""


class Columns(NamedTuple):
    """The columns of sessions, without the time: measured states, commands, and the interval between rows [s]."""

    state: tuple[str, ...]
    command: tuple[str, ...]
    time_step: float


SPOT = Columns(tuple(STATE), tuple(COMMAND), TIME_STEP)
"""Those of the robot that walks."""


def every_fourth(sessions: int) -> range:
    """Which of the sessions are held out; the last one of fewer than four."""
    return range(min(3, sessions - 1), sessions, 4)


def write(
    folder: Path, measured: Array, command: Array, columns: Columns = SPOT, model: str = "", simulator: str = ""
) -> None:
    """A CSV a session, `a.csv` to `h.csv` and so on, all numbers as wide as each other; the user's model or the name of
    the user's simulator too, if there is one."""
    folder.mkdir(parents=True)
    for s in range(len(measured)):
        rows = np.column_stack([np.arange(measured.shape[1]) * columns.time_step, measured[s], command[s]])
        path = folder / f"{chr(ord('a') + s)}.csv"
        with path.open("w") as file:
            file.write(",".join(("time_s", *columns.state, *columns.command)) + "\n")
            np.savetxt(file, np.clip(rows, -9999, 9999), fmt="%+012.6f", delimiter=",")
    for name, text in ((MODEL, model), (SIMULATOR, simulator)):
        if text:
            (folder / name).write_text(text)
    for path in (*folder.iterdir(), folder):
        os.utime(path, (EPOCH, EPOCH))


def read(folder: Path) -> tuple[Array, Array]:
    """What `write` wrote of the robot that walks: measured states [S, T, 12] and commands [S, T, 6]."""
    tables = [np.loadtxt(path, delimiter=",", skiprows=1) for path in sorted(folder.glob("*.csv"))]
    table, states = np.stack(tables), 1 + len(SPOT.state)
    return table[:, :, 1:states], table[:, :, states:]
