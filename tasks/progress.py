"""Progress for people: bars with rates and remaining time in a terminal, a line now and then in a log."""

import logging
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from simgap.types import Report

_EVERY_S = 15.0
console = Console()


class Stopped(BaseException):
    """Raised by `report` in work that is to end: the process was told to."""


class Bars:
    """A bar for the whole and one for each job under way; safe to use from several threads."""

    def __init__(self, progress: Progress, what: str, total: int, clock: Callable[[], float]) -> None:
        self._progress, self._clock = progress, clock
        self._whole = progress.add_task(what, total=total, rate="")
        self._what, self._total, self._done = what, total, 0
        self._spoke = clock()
        self._lock = threading.Lock()
        self._stopped = threading.Event()

    def stop(self) -> None:
        """End the jobs under way, each at its next report."""
        self._stopped.set()

    @contextmanager
    def job(self, name: str, steps: int) -> Iterator[Report]:
        """A job of so many steps; yields its `report`."""
        bar = self._progress.add_task(f"  {name}", total=steps, rate="")
        start = self._clock()

        def report(step: int, metrics: dict[str, float]) -> None:
            if self._stopped.is_set():
                raise Stopped(name)
            pace = _pace(step, self._clock() - start)
            shown = ", ".join(f"{k.replace('_', ' ')} {v:.2f}" for k, v in metrics.items())
            self._progress.update(bar, completed=step, rate=f"{pace}  {shown}")
            most = f" of at most {steps:,}" if steps else ""
            self._say(f"{name}: step {step:,}{most}, {pace}{shown and ', '}{shown}")

        try:
            yield report
        finally:
            self._progress.remove_task(bar)
            with self._lock:
                self._done += 1
            self._progress.update(self._whole, advance=1)
            self._say(f"{self._what}: {self._done} of {self._total} done ({name})", always=True)

    def _say(self, line: str, always: bool = False) -> None:
        if console.is_terminal:
            return
        with self._lock:
            if always or self._clock() - self._spoke > _EVERY_S:
                self._spoke = self._clock()
                say(line)


def _pace(steps: int, seconds: float) -> str:
    """Steps a second, or seconds a step where that is slow."""
    if steps >= seconds:
        return f"{steps / max(seconds, 1e-9):,.0f} steps/s"
    return f"{seconds / steps:,.0f} s a step" if steps else "no step yet"


@contextmanager
def bars(what: str, total: int, clock: Callable[[], float]) -> Iterator[Bars]:
    """Bars for `total` jobs; `clock` gives seconds."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
               TimeRemainingColumn(), TextColumn("{task.fields[rate]}"))  # fmt: skip
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        yield Bars(progress, what, total, clock)


@contextmanager
def plain_job(name: str, _steps: int) -> Iterator[Report]:
    """A job in a process that has no bars: a line when it begins and when it is done."""
    say(f"{name}: begun")
    yield lambda _step, _metrics: None
    say(f"{name}: done")


def table(title: str, rows: Sequence[dict[str, Any]]) -> None:
    """Print rows of the same keys as a table."""
    if not rows:
        return
    view = Table(title=title, title_justify="left")
    for name in rows[0]:
        justify = "left" if isinstance(rows[0][name], str) else "right"
        view.add_column(name.replace("_", " "), justify=justify, overflow="fold")
    for row in rows:
        view.add_row(*(f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()))
    console.print(view)


def say(line: str) -> None:
    """Print a line as it is, above the bars if there are any: a unit in brackets is no style."""
    line = line.encode("utf-8", "backslashreplace").decode("utf-8")  # a file's name may be no UTF-8
    console.print(line, highlight=False, soft_wrap=True, markup=False, emoji=False)
    _log(line)


def _log(line: str) -> None:
    """The line for Prefect's pages, where a flow runs; in a terminal Prefect prints warnings and errors alone."""
    if "prefect" not in sys.modules:  # loading it takes seconds, and no flow runs without
        return
    from prefect.exceptions import MissingContextError
    from prefect.logging import get_run_logger

    with suppress(MissingContextError):
        get_run_logger().info(line)


def quiet_libraries() -> None:
    """Leave warnings and errors of the libraries' logs; drop their chatter, and tracebacks."""
    for name in ("httpx", "alembic", "distributed", "mlflow", "prefect"):
        logging.getLogger(name).setLevel(logging.WARNING)
    # That a server is gone is told once; this would tell it again for every try.
    logging.getLogger("urllib3").setLevel(logging.ERROR)
    for name in ("prefect.flow_runs", "prefect.task_runs"):
        logging.getLogger(name).addFilter(_has_no_traceback)


def _has_no_traceback(record: logging.LogRecord) -> bool:
    # An error is reported once, where the process ends.
    return not record.exc_info
