"""A process that diagnoses sealed recordings: locked away from the keys before it reads its first case.

`python -m flows.sealed.examiner KEYS` reads a line `{"case", "out", "seed"}` a case and answers `{"seconds", "error"}`.
"""

import json
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

import flows  # noqa: F401  # settles the environment before JAX is imported
from simgap.diagnosis.diagnose import diagnose
from simgap.formats.documents import write_json
from simgap.simulators.spot import Spot
from tasks.diagnose import Folders, read
from tasks.sealed.lock import lock
from tasks.sealed.workspace import AFTER, BEFORE


def examine(case: Path, out: Path, seed: int) -> None:
    """Diagnose the kinematic model on a case's recordings and write the statement."""
    simulator = Spot()
    after = case / AFTER
    folders = Folders(after, baseline=case / BEFORE) if after.exists() else Folders(case)
    sessions, errors = read.fn(folders, simulator)
    if errors:
        raise ValueError("; ".join(errors))
    found = diagnose(simulator, "spot", sessions, seed)
    write_json(out, found.statement)


def _answer(line: str) -> dict[str, Any]:
    asked, start = json.loads(line), time.perf_counter()
    try:
        examine(Path(asked["case"]), Path(asked["out"]), asked["seed"])
    except Exception as error:  # whatever it is, the next case shall be diagnosed
        return {"error": f"{type(error).__name__}: {error}", "seconds": time.perf_counter() - start}
    return {"error": None, "seconds": time.perf_counter() - start}


def _end_with(parent: int) -> None:
    """End with the process that asks: a killed stage must find nobody at work when it is started again."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _main() -> None:
    lock(Path(sys.argv[1]))
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    for line in sys.stdin:
        print(json.dumps(_answer(line)), flush=True)


if __name__ == "__main__":
    _main()
