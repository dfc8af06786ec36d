"""The stage `ground`: cases of the training ground, diagnosed in processes of their own and scored."""

import os
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from pathlib import Path
from queue import Queue

import pytest

from flows import ground as flow
from simgap.ground.draw import draw
from tasks import ground, verdicts
from tasks.params_machines import GroundParams, load_ground
from tasks.processes import one_process

ROOT = Path(__file__).parents[2]
NOTHING_MISSING = 9


@pytest.mark.long
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
    dead, idle = one_process(), Queue()
    with pytest.raises(BrokenProcessPool):
        dead.submit(os._exit, 1).result()
    idle.put(dead)
    job = lambda *_: nullcontext(lambda *_: None)  # noqa: E731
    with pytest.raises(BrokenProcessPool):
        ground.diagnose_case.fn(NOTHING_MISSING, 0, idle, job, print)
    with idle.get() as process:
        assert process.submit(abs, -1).result() == 1
    assert idle.empty()


def test_a_process_ends_when_what_started_it_is_killed() -> None:
    """An idle one waits for work, which nobody would send it any more, and holds gigabytes."""
    start = "from tasks.processes import one_process; import os, time; process = one_process()"
    say = "print(process.submit(os.getpid).result(), flush=True); time.sleep(600)"
    with subprocess.Popen([sys.executable, "-c", f"{start}; {say}"], stdout=subprocess.PIPE, text=True) as flow_process:
        assert flow_process.stdout is not None
        worker = Path("/proc", flow_process.stdout.readline().strip())
        assert worker.exists()
        flow_process.kill()
        for _ in range(100):
            if not worker.exists():
                return
            time.sleep(0.1)
    pytest.fail("the process waits on")


def test_the_file_of_parameters_is_whole() -> None:
    assert load_ground(ROOT / "pipelines" / "ground" / "params.yaml").cases > 0
