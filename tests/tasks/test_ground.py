"""The stage `ground`: cases of the training ground, diagnosed in processes of their own and scored."""

import os
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from pathlib import Path
from queue import Queue

import pytest

from flows import ground as flow
from simgap.ground.draw import draw
from tasks import ground, verdicts
from tasks.params_machines import GroundParams, load_ground

ROOT = Path(__file__).parents[2]
NOTHING_MISSING = 9


def test_every_case_is_a_row_and_a_finished_one_is_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = draw(NOTHING_MISSING)
    assert not case.families
    params = GroundParams(seed=0, first=NOTHING_MISSING, cases=1, workers=1)
    flow.run(params, tmp_path)
    (row,) = verdicts.Runs(tmp_path / ground.RUNS, "").every
    assert (row["case"], row["machine"], row["kind"]) == (str(NOTHING_MISSING), case.machine.name, "nothing")
    assert row["outcome"] in ("right", "open")
    assert float(row["sure"]) == 0

    monkeypatch.setattr(flow.ground, "diagnose_case", None)  # nobody is to call it
    flow.run(params, tmp_path)
    assert "1 of 1 cases are diagnosed already" in capsys.readouterr().out


def test_a_process_that_dies_is_replaced_and_loses_no_other_case() -> None:
    dead, idle = ground.one_process(), Queue()
    with pytest.raises(BrokenProcessPool):
        dead.submit(os._exit, 1).result()
    idle.put(dead)
    job = lambda *_: nullcontext(lambda *_: None)  # noqa: E731
    with pytest.raises(BrokenProcessPool):
        ground.diagnose_case.fn(NOTHING_MISSING, 0, idle, job, print)
    with idle.get() as process:
        assert process.submit(abs, -1).result() == 1
    assert idle.empty()


def test_the_file_of_parameters_is_whole() -> None:
    assert load_ground(ROOT / "pipelines" / "ground" / "params.yaml").cases > 0
