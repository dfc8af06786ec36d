"""What long work says of its pace and its steps, in a terminal and in a log."""

import time
from collections.abc import Iterator
from io import StringIO

import pytest
from rich.console import Console

from simgap.cli import progress


@pytest.mark.parametrize(
    ("step", "seconds", "said"), [(120_000, 60.0, "2,000 steps/s"), (15, 60.0, "4 s a step"), (0, 60.0, "no step yet")]
)
def test_fast_work_is_told_in_steps_a_second_and_slow_work_in_seconds_a_step(
    step: int, seconds: float, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    with progress.bars("cells", 1, lambda: now) as bars, bars.job("one", 0) as report:
        now = seconds
        report(step, {})
    assert said in capsys.readouterr().out


@pytest.fixture
def printed(monkeypatch: pytest.MonkeyPatch) -> Iterator[StringIO]:
    """What a terminal gets."""
    terminal = StringIO()
    monkeypatch.setattr(progress, "console", Console(file=terminal, force_terminal=True, width=100))
    yield terminal
    progress.choose(quiet=False, verbose=False, json=False)


@pytest.mark.parametrize(("verbose", "lines"), [(False, 0), (True, 1)])
def test_a_terminal_shows_the_step_under_way_and_keeps_it_where_that_is_asked_for(
    printed: StringIO, verbose: bool, lines: int
) -> None:
    progress.choose(quiet=False, verbose=verbose, json=False)
    with progress.steps("diagnosing") as step:
        step("tried [gain]")  # brackets are no style
        time.sleep(0.2)  # bars are drawn ten times a second
    assert "diagnosing: tried [gain]" in printed.getvalue()
    assert ("  tried [gain]\n" in printed.getvalue()) == bool(lines)


def test_a_log_gets_a_line_a_step_and_a_quiet_command_none(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.steps("diagnosing") as step:
        step("tried gain")
    assert capsys.readouterr().out == "  tried gain\n"
    progress.choose(quiet=True, verbose=False, json=False)
    with progress.steps("diagnosing") as step:
        step("tried gain")
    progress.say("error: wrong", always=True)
    progress.choose(quiet=False, verbose=False, json=False)
    assert capsys.readouterr().out == "error: wrong\n"
