"""Stage `ground`: cases of the training ground diagnosed, and scored against what they lack."""

from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from pathlib import Path
from queue import Queue
from typing import Any

from prefect import task

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.validation.indicators import Indicators
from simgap.ground.draw import Case, draw
from simgap.types import Report, SimgapError
from tasks import verdicts
from tasks.processes import one_process

RUNS = Path("reports/ground/runs.csv")
MEASURED = tuple(name for name in Indicators._fields if name != "mistaken")
"""Indicators that are kept: how often an effect is mistaken is counted in the whole table."""
Job = Callable[[str, int], AbstractContextManager[Report]]
Keep = Callable[[Mapping[str, Any]], None]


@task(task_run_name="diagnose-{number}")
def diagnose_case(number: int, seed: int, idle: Queue[ProcessPoolExecutor], job: Job, keep: Keep) -> None:
    """Have an idle process diagnose a case, and keep its row of the table; one that dies is replaced."""
    process = idle.get()
    try:
        with job(str(number), 1):
            keep(process.submit(diagnosed, number, seed).result())
    except BrokenProcessPool:
        process = one_process()
        raise
    finally:
        idle.put(process)


def diagnosed(number: int, seed: int) -> dict[str, Any]:
    """The row of a case: what it is, what is said of it, and how right that is."""
    case = draw(number)
    try:
        statement = diagnose(case.machine, case.machine.name, case.sessions, seed).statement
        said = verdicts.judged(case.causes, statement) | _found(case.causes, statement)
    except SimgapError as error:
        said = verdicts.failed(str(error))
    return {"case": number, **_drawn(case), **said}


def _drawn(case: Case) -> dict[str, Any]:
    return {
        "machine": case.machine.name,
        "kind": case.kind,
        "families": verdicts.SEPARATOR.join(case.families),
        "tails": case.tails,
        "rows": sum(len(r.time_s) for r in case.sessions.fitted),
        "strength": round(case.strength, 1),
    }


def _found(causes: Sequence[Collection[str]], statement: Mapping[str, Any]) -> dict[str, Any]:
    """Every effect found, named or not: whether a cause is among its names, and what speaks for and against it."""
    effects = statement["found"]
    columns = {
        "found": [e["id"] for e in effects],
        "right": [str(int(verdicts.is_right(causes, e))) for e in effects],
        **{name: [f"{e['indicators'][name]:.4g}" for e in effects] for name in MEASURED},
    }
    return {name: verdicts.SEPARATOR.join(parts) for name, parts in columns.items()}
