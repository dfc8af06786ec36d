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

# A core a case: with threads of XLA for two, a case takes a sixth less time, but a tenth more of the processor's.
os.environ.setdefault("PJRT_NPROC", "1")

import flows  # noqa: F401  # settles the environment before JAX is imported
import simgap.simulators.mujoco  # noqa: F401  # MuJoCo starts a process when it is imported, which the lock forbids
from simgap.api import diagnose
from simgap.formats.diagnoses import EXPERIMENT, write_experiment
from simgap.formats.documents import write_json
from simgap.loading.load import find
from tasks.sealed.lock import lock
from tasks.sealed.workspace import AFTER, BEFORE, MODEL, PRESCRIBED, RECORDED, SIMULATOR


def examine(case: Path, out: Path, seed: int) -> None:
    """Diagnose a case's own model or simulator on its recordings, or that of the Spot; write the statement."""
    after, before = case / AFTER, case / BEFORE
    simulator = simulator_of(case)
    if after.exists():
        found = diagnose(simulator, after, baseline=before, seed=seed)
    else:
        found = diagnose(simulator, recordings_of(case), seed=seed)
    if found.left_out:
        raise ValueError("; ".join(found.left_out))
    if found.found.experiment is not None:
        write_experiment(out.parent / EXPERIMENT, found.found.experiment, found.diagnosed.schema)
    write_json(out, found.statement)


def simulator_of(case: Path) -> Any:
    """The model file that a case has, or the simulator that it names, or the kinematic model of the Spot."""
    if (case / MODEL).exists():
        return case / MODEL
    if not (case / SIMULATOR).exists():
        return "spot"
    return find((case / SIMULATOR).read_text())  # unchecked: a check takes a process of its own, which the lock forbids


def recordings_of(case: Path) -> list[Path]:
    """The folders of a case's sessions: what was recorded, and the experiment that a diagnosis of it prescribed."""
    return [case / RECORDED, case / PRESCRIBED] if (case / PRESCRIBED).exists() else [case]


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
