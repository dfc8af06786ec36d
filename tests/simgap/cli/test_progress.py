"""What long work says of its pace where no terminal shows bars."""

import pytest

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
