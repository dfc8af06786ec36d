"""Progress for people: bars with rates and remaining time in a terminal, a line now and then in a log."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from simgap.types import Report

_EVERY_S = 15.0
console = Console()
listeners: list[Callable[[str], None]] = []
"""Whoever else wants every line that is said."""


class _Asked:
    """What the command was asked for."""

    quiet = verbose = False


_asked = _Asked()


def choose(*, quiet: bool, verbose: bool, json: bool) -> None:
    """How much is said; with `json`, on standard error."""
    _asked.quiet, _asked.verbose = quiet, verbose
    console.stderr = json


class Stopped(BaseException):
    """Raised by `report` in work that is to end, with the process."""


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


def say(line: str, always: bool = False) -> None:
    """Print a line as it is, above the bars if there are any: a unit in brackets is no style.

    `always`: also where the command was asked to be quiet.
    """
    line = line.encode("utf-8", "backslashreplace").decode("utf-8")  # a file's name may be no UTF-8
    if always or not _asked.quiet:
        console.print(line, highlight=False, soft_wrap=True, markup=False, emoji=False)
    for listen in listeners:
        listen(line)


@contextmanager
def steps(what: str) -> Iterator[Callable[[str], None]]:
    """Long work whose steps are not known before: yields what to call with every step, in words.

    In a terminal the step under way is shown with the time; every step keeps a line of its own where the command was
    asked to be verbose, and in a log.
    """
    if not console.is_terminal or _asked.quiet:
        yield lambda line: say(f"  {line}")
        return
    with Progress(SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=console,
                  transient=True) as bar:  # fmt: skip
        task = bar.add_task(what, total=None)

        def step(line: str) -> None:
            bar.update(task, description=f"{what}: {escape(line)}")
            if _asked.verbose:
                say(f"  {line}")

        yield step
